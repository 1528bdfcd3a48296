// The page to choose on: a click sets the focus, a slider the blur; the nearest picture is shown.
const { renders, focuses, strengths, metric, ends, command } = own;
const slider = $("strength"), [input, depth] = items[0].layers;
const choice = { place: own.place, strength: own.strength, focus: 0, end: 0 };

const inWords = value => !metric ? `the number ${+value.toPrecision(5)} of the depth`
  : value > 0 ? `${+(1 / value).toPrecision(4)} m` : "infinity";

// Choose a pixel, a strength, and the end of relative depth that is near; values are disparities,
// in metres the inverse of distances.
async function choose(place, strength, end = choice.end) {
  Object.assign(choice, { place, strength, end });
  const [value] = numbersAt(await valuesSoon(depth, items[0]).promise, ...place);
  const apart = focuses.map(each => Math.abs(each.value - value));
  choice.focus = apart.indexOf(Math.min(...apart));
  const { words, option } = strengths[strength], nearest = inWords(focuses[choice.focus].value);
  const focus = !metric ? `--focus-at ${place}` : `--focus ${inWords(value).replace("inity", "").replace(" ", "")}`;
  const { sharp } = focuses[choice.focus], { option: near, words: which } = ends[end];
  $("blur").textContent = words;
  $("end").textContent = which;
  slider.value = strength;
  slider.setAttribute("aria-valuetext", words);
  Object.assign(items[0], {
    layers: [input, renders[end][choice.focus][strength], depth],
    commands: [["Command", `${command}${ends.length > 1 ? near : ""}${sharp} ${option} ${focus}`]],
    facts: [
      ["In focus", `${inWords(value)}, at ${place}`],
      ["Shown", `the nearest of ${focuses.length} × ${strengths.length} small pictures made beforehand: ${nearest} in focus, ${words}. The command renders what is chosen, at full size.`],
    ],
  });
  view.mark = place;
  showItem(0);
  tell(`${inWords(value)} in focus, ${words}${ends.length > 1 ? `, ${which}` : ""}`);
}

const focusBy = steps => choose(focuses[clamped(choice.focus + steps, 0, focuses.length - 1)].place, choice.strength);
const blurBy = steps => choose(choice.place, clamped(choice.strength + steps, 0, strengths.length - 1));
clickAt = (x, y) => {
  if (x >= 0 && y >= 0 && x < depth.size[0] && y < depth.size[1]) choose([x, y], choice.strength);
};
const turn = () => ends.length > 1 && choose(choice.place, choice.strength, 1 - choice.end);
$("end").hidden = ends.length < 2;
$("end").onclick = turn;
slider.max = strengths.length - 1;
slider.oninput = () => choose(choice.place, Number(slider.value));
Object.assign(KEYS, {
  ArrowLeft: () => focusBy(ends[choice.end].near), ArrowRight: () => focusBy(-ends[choice.end].near), i: turn, ArrowUp: () => blurBy(1), ArrowDown: () => blurBy(-1),
  c: () => document.querySelector("#details button").click(),
});
view.mode = "second";
choose(choice.place, choice.strength);
