// The report: a table to sort and filter, whose rows the viewer shows.
const body = document.querySelector("#rows tbody");
const rows = [...body.rows], FRAME = 1000 / 12;
let order = items.map((_, n) => n);

function show(number, quietly) {
  if (!items[number]) return;
  rows[view.item]?.removeAttribute("aria-current");
  rows[number].setAttribute("aria-current", "true");
  if (!quietly) rows[number].scrollIntoView({ block: "nearest" });
  showItem(number);
  position();
  if (!quietly) tell(`${item().name}: ${item().status}`);
}

// Number of the item; if names end in digits, as those of frames do, the number of the frame.
function position() {
  const frame = /(\d+)(?:\.[a-z]\w*)?$/i.exec(item().name);
  const place = `${order.indexOf(view.item) + 1} of ${order.length}`;
  $("position").textContent = frame ? `${place} · frame ${frame[1]}` : place;
}

function step(by) {
  const place = order.indexOf(view.item);
  const next = order[place < 0 ? 0 : clamped(place + by, 0, order.length - 1)];
  if (next !== undefined && next !== view.item) show(next);
}

function play() {
  $("play").setAttribute("aria-pressed", String(!view.film));
  if (view.film) { view.film = clearInterval(view.film); draw(); return; }
  const after = steps => order[(order.indexOf(view.item) + steps) % order.length];
  view.film = setInterval(() => {
    if (!order.length) return; // nothing passes the filter
    show(after(1), true);
    for (const key of [view.first, view.second]) { // decoded before they are due
      thumbOf(items[after(1)].layers.find(each => each.key === key));
    }
  }, FRAME);
}

// ---- the table

const RULE = /^([\w.-]+)(<=|>=|<|>)([-+\d.e]+)$/;
const numeric = value => value === undefined ? NaN : Number(value);

function matcher() {
  const tests = $("filter").value.toLowerCase().split(/\s+/).filter(Boolean).map(word => {
    const rule = RULE.exec(word);
    if (!rule) return each => `${each.name} ${each.words}`.toLowerCase().includes(word);
    const [, name, sign, bound] = rule, limit = Number(bound);
    return each => {
      const value = numeric(each.metrics[name]);
      return { "<": value < limit, "<=": value <= limit, ">": value > limit, ">=": value >= limit }[sign];
    };
  });
  const statuses = new Set([...document.querySelectorAll("[name=status]:checked")].map(each => each.value));
  return each => statuses.has(each.status) && tests.every(test => test(each));
}

let sorting = { by: "rank", down: false };
const collator = new Intl.Collator("en", { numeric: true });

function compare(m, n) {
  const { by } = sorting;
  if (by === "rank") return m - n;
  if (by === "name") return collator.compare(items[m].name, items[n].name);
  const [a, b] = [m, n].map(each => numeric(items[each].metrics[by]));
  if (Number.isNaN(a) && Number.isNaN(b)) return 0;
  return Number.isNaN(a) ? 1 : Number.isNaN(b) ? -1 : a - b || 0;
}

function list_rows() {
  const matches = matcher(), sorted = items.map((_, n) => n).sort((m, n) => (sorting.down ? -1 : 1) * compare(m, n) || m - n);
  order = sorted.filter(n => matches(items[n]));
  const shown = new Set(order);
  rows.forEach((row, n) => { row.hidden = !shown.has(n); });
  body.append(...sorted.map(n => rows[n]));
  $("nothing").hidden = order.length > 0;
  $("shown").textContent = order.length < items.length ? `${order.length} of ${items.length}` : "";
  for (const button of document.querySelectorAll("[data-sort]")) {
    const is_own = button.dataset.sort === sorting.by;
    button.parentElement.setAttribute("aria-sort", is_own ? (sorting.down ? "descending" : "ascending") : "none");
  }
  if (order.length && !shown.has(view.item)) show(order[0], true);
  else if (item()) position();
}

function sort(by) {
  sorting = { by, down: sorting.by === by && !sorting.down };
  list_rows();
}

// Thumbnails are decoded as they come into view.
const watcher = new IntersectionObserver(entries => {
  for (const { target, isIntersecting } of entries) {
    if (!isIntersecting) continue;
    watcher.unobserve(target);
    target.src = addressOf(target.dataset.payload);
  }
}, { root: null, rootMargin: "200px" });

// ---- what people do

Object.assign(KEYS, {
  ArrowLeft: () => step(-1), ArrowUp: () => step(-1), ArrowRight: () => step(1), ArrowDown: () => step(1),
  " ": play, "/": () => $("filter").focus(),
});
const ticked = () => items.filter((_, n) => rows[n].querySelector(".tick")?.checked).map(each => each.ticked);
body.addEventListener("change", () => {
  const number = ticked().length, title = `Accept ${number} ticked`;
  $("accept").replaceChildren(...(number ? [commandLine(title, [own.accept, ...ticked()].join(" "))] : []));
});
body.addEventListener("click", event => {
  if (event.target.matches(".tick")) return;
  const row = event.target.closest("tr");
  if (row) show(Number(row.dataset.item), true);
});
for (const button of document.querySelectorAll("[data-sort]")) button.onclick = () => sort(button.dataset.sort);
$("filters").addEventListener("input", list_rows);
$("filters").addEventListener("submit", event => event.preventDefault());
[$("previous").onclick, $("play").onclick, $("next").onclick] = [KEYS.ArrowLeft, play, KEYS.ArrowRight];
for (const image of document.querySelectorAll("img[data-payload]")) watcher.observe(image);
list_rows();
