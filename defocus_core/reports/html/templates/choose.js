// The page to choose on: a click sets the focus, a slider the blur; the nearest picture is shown.
(() => {
const { size, map, ends, metric, focuses, strengths, names, command, ...first } = JSON.parse($("data").textContent);
const picture = $("picture"), slider = $("strength");
const view = { place: first.place, strength: first.strength, focus: 0 };
let numbers = null; // of the map: red is the high byte, green the low one

const distance = value => value > 0 ? `${+(1 / value).toPrecision(4)}m` : "inf";
const named = value => metric ? (value > 0 ? `${+(1 / value).toPrecision(4)} m` : "infinity") : `the number ${+value.toPrecision(5)} of the depth`;

// The disparity of a pixel of the whole picture.
function valueAt([x, y]) {
  const column = Math.floor((x + 0.5) * numbers.width / size[0]), row = Math.floor((y + 0.5) * numbers.height / size[1]);
  const n = 4 * (row * numbers.width + column), share = (256 * numbers.data[n] + numbers.data[n + 1]) / 65535;
  return ends[0] + share * (ends[1] - ends[0]);
}

function nearest(value) {
  const off = focuses.map(each => Math.abs(each.value - value));
  return off.indexOf(Math.min(...off));
}

async function show() {
  if (!numbers) return;
  const value = valueAt(view.place), { words, option } = strengths[view.strength];
  view.focus = nearest(value);
  const own = focuses[view.focus].value, [x, y] = view.place;
  const focus = metric ? `--focus ${distance(value)}` : `--focus-at ${x},${y}`;
  $("focus").textContent = `In focus: ${named(value)}, at ${x},${y}`;
  $("blur").textContent = words;
  slider.value = view.strength;
  slider.setAttribute("aria-valuetext", words);
  $("details").replaceChildren(commandLine("Command", `${command} ${option} ${focus}`));
  $("shown").textContent = `Shown is the nearest of ${focuses.length} × ${strengths.length} small drafts made beforehand: ${named(own)} in focus, ${words}. The command renders what is chosen, at full size.`;
  const name = names[view.focus][view.strength];
  picture.src = await addressOf(name);
  await picture.decode().catch(() => {}); // another was chosen meanwhile
  picture.alt = `${named(own)} in focus, ${words}`;
  mark();
  picture.dataset.shown = `${view.focus},${view.strength}`;
}

function mark() {
  const box = picture.getBoundingClientRect(), stage = $("view").getBoundingClientRect();
  $("mark").style.left = `${box.left - stage.left + (view.place[0] + 0.5) / size[0] * box.width}px`;
  $("mark").style.top = `${box.top - stage.top + (view.place[1] + 0.5) / size[1] * box.height}px`;
}

function focusBy(steps) {
  view.place = focuses[Math.max(0, Math.min(focuses.length - 1, view.focus + steps))].place;
  show();
}

function blurBy(steps) {
  view.strength = Math.max(0, Math.min(strengths.length - 1, view.strength + steps));
  show();
}

picture.addEventListener("click", event => {
  const box = picture.getBoundingClientRect();
  const at = (client, start, length, count) => Math.max(0, Math.min(count - 1, Math.floor((client - start) / length * count)));
  view.place = [at(event.clientX, box.left, box.width, size[0]), at(event.clientY, box.top, box.height, size[1])];
  show();
});
slider.max = strengths.length - 1;
picture.style.setProperty("--ratio", size[0] / size[1]);
slider.addEventListener("input", () => { view.strength = Number(slider.value); show(); });

const KEYS = {
  ArrowLeft: () => focusBy(first.near), ArrowRight: () => focusBy(-first.near),
  ArrowUp: () => blurBy(1), ArrowDown: () => blurBy(-1),
  c: () => document.querySelector("#details button").click(), "?": () => $("help").showModal(),
};
listen(KEYS, ({ target, key }) => target === slider && key.startsWith("Arrow"));
new ResizeObserver(mark).observe($("view"));

pixelsOf(map).then(pixels => {
  numbers = pixels;
  return show();
});
})();
