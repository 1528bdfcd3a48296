// The report: a table to sort and filter, and a viewer of the values of pictures on a 2D canvas.
(() => {
const { items, heats, signed, nonfinite } = JSON.parse($("data").textContent);
const body = document.querySelector("#rows tbody");
const rows = [...body.rows];
// What is shown, and how; it stays while items change. Place and zoom are in px of the picture.
const view = {
  item: -1, order: items.map((_, n) => n), mode: "slider", shown: "slider", first: "", second: "",
  overlay: "", stops: 0, split: 0.5, zoom: 0, x: 0, y: 0, size: "", turn: false,
};
const MAX_ZOOM = 64, PERIOD = 500, FRAME = 1000 / 12;
let film = 0, flickering = 0;
const item = () => items[view.item];
const layerOf = key => item() && item().layers.find(layer => layer.key === key);
const pictured = () => item() ? item().layers.filter(layer => layer.key !== "difference") : [];
const clamped = (value, low, high) => Math.max(low, Math.min(high, value));

// ---- values of layers

function number(half) {
  const exponent = (half >> 10) & 31, fraction = half & 1023, sign = half & 0x8000 ? -1 : 1;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : fraction * 2 ** -24);
}
const HALVES = Float64Array.from({ length: 65536 }, (_, half) => number(half));

function kept(map, key, most, make) {
  if (!map.has(key)) map.set(key, make());
  const value = map.get(key);
  map.delete(key);
  map.set(key, value); // the last used is the last
  if (map.size > most) map.delete(map.keys().next().value);
  return value;
}

// What is decoded, as a promise, and made when it is there; the picture is drawn again then.
const decoded = new Map(), tables = new Map();
const soon = (name, make) => kept(decoded, name, 24, () => {
  const entry = { made: null, promise: make() };
  entry.promise.then(made => { entry.made = made; draw(); }, error => fail(`A picture cannot be shown: ${error.message}`));
  return entry;
});

// Bits of halves: differences to the left neighbour or to another layer; low bytes, then high ones.
async function unpack(owner, { values: { payload, size: [width, height], base }, channels: { length: channels } }) {
  const count = width * height, total = count * channels, bits = new Uint16Array(total);
  const stream = new Blob([await bytesOf(payload)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const other = base && (await valuesSoon(owner.layers.find(each => each.key === base), owner).promise).data;
  for (let channel = 0, n = 0; channel < channels; channel++) {
    for (let pixel = 0, place = channel; pixel < count; pixel++, n++, place += channels) {
      const before = other ? other[place] : pixel % width ? bits[place - channels] : 0;
      bits[place] = before + bytes[n] + (bytes[n + total] << 8);
    }
  }
  return bits;
}

// Numbers of a layer in a box of the picture: of its thumbnail, of its values; how they are decoded.
const thumbOf = layer => layer && layer.thumbnail && soon(layer.thumbnail, async () => {
  const { data, width, height } = await pixelsOf(layer.thumbnail);
  const [low, high] = ["light", "heat"].includes(layer.kind) ? [0, 1] : layer.ends;
  const numbers = Float64Array.from({ length: 256 }, (_, grey) => low + grey / 255 * (high - low));
  return { data, width, height, stride: 4, box: [0, 0, ...layer.size], gamma: null, scale: "thumbnail", numbers };
}).made;
const valuesSoon = (layer, owner = item()) => soon(layer.values.payload, async () => {
  const { corner, size: [width, height], scale } = layer.values, numbers = HALVES.map(each => each * scale);
  const data = await unpack(owner, layer), box = [...corner, width, height];
  return { data, width, height, stride: layer.channels.length, box, gamma: layer.gamma, scale, numbers };
});
const valuesGrid = layer => layer && layer.values && !(film && layer.thumbnail) && valuesSoon(layer).made;

// The greatest difference of each pixel: of two layers, or of the layer that has it where halves do not tell it.
function differences(first, second) {
  const own = ofPair() && layerOf("difference"), lone = Boolean(own && own.values);
  const [a, b] = lone ? [null, valuesGrid(own)] : [valuesGrid(first), valuesGrid(second)];
  if (!b || !(lone || (a && String(a.box) === String(b.box)))) return null;
  return soon([first, second].map(layer => layer.values?.payload).join(), async () => {
    const data = new Float32Array(b.width * b.height);
    for (let n = 0, k = 0; n < data.length; n++) {
      for (const end = k + b.stride; k < end; k++) {
        const one = lone ? 0 : a.numbers[a.data[k]], other = b.numbers[b.data[k]];
        const apart = one === other || (one !== one && other !== other) ? 0 : Math.abs(other - one);
        if (!(apart <= data[n])) data[n] = apart; // NaN, too, which nothing exceeds
      }
    }
    return { ...b, data, stride: 1 };
  }).made;
}

// ---- colours of numbers

const packed = (red, green, blue, alpha = 1) =>
  ((Math.round(255 * alpha) << 24) | (Math.round(255 * blue) << 16) | (Math.round(255 * green) << 8) | Math.round(255 * red)) >>> 0;
const mixed = (one, other, share) => packed(...one.map((each, k) => each + (other[k] - each) * share));
const BAD = packed(...nonfinite);
const HEATS = Uint32Array.from({ length: 256 }, (_, n) => {
  const place = n / 255 * (heats.length - 1), low = Math.min(Math.floor(place), heats.length - 2);
  return mixed(heats[low], heats[low + 1], place - low);
});
const toLight = (v, gamma) => gamma === null ? (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4) : gamma === 1 ? v : v ** gamma;
const toScreen = v => v <= 0.0031308 ? 12.92 * v : 1.055 * Math.min(v, 1) ** (1 / 2.4) - 0.055;

// The colour of each number at the exposure, as a table; over a picture it is clear, in part.
function colors(grid, { kind, ends: [low, high] }, over) {
  const name = [kind, low, high, grid.gamma, grid.scale, over, view.stops].join(), gain = over || kind === "heat" ? 1 : 2 ** view.stops;
  const share = v => clamped((v - low) / (high - low) * gain, 0, 1), most = v => clamped(Math.abs(v) / high * gain, 0, 1);
  const grey = ["light", "heat"].includes(kind) ? v => toScreen(gain * toLight(Math.max(v, 0), grid.gamma)) : share;
  const colorOf = kind === "signed"
    ? v => over ? packed(...signed[v < 0 ? 0 : 2], 0.75 * most(v)) : mixed(signed[1], signed[v < 0 ? 0 : 2], most(v))
    : v => over ? packed(...heats[3], 1 - Math.max(share(v), 0.2)) : 0x1010101 * Math.round(255 * grey(v)) | 0xff000000;
  return kept(tables, name, 8, () => Uint32Array.from(grid.numbers, v => Number.isFinite(v) ? colorOf(v) : BAD));
}

// ---- the picture: values lie in a window of it; around it the thumbnail shows

const IN_MEMORY = { willReadFrequently: true }; // canvases that no graphics card draws: as fast without one
const canvas = $("canvas"), context = canvas.getContext("2d", IN_MEMORY);
const scratch = document.createElement("canvas"), pad = scratch.getContext("2d", IN_MEMORY);
let camera = null; // while it is drawn: px of the picture at the left top of the canvas, and zoom

function fail(words) {
  $("failure").textContent = words;
  $("failure").hidden = false;
}

// Draw a grid between two columns of the canvas, at the size shown: the colour of each place in its data.
function drawGrid({ data, width, height, stride, box: [x, y, wide, high] }, from, to, colorAt) {
  const across = camera.zoom * wide / width, down = camera.zoom * high / height; // canvas px of a number
  const left = (x - camera.x) * camera.zoom, top = (y - camera.y) * camera.zoom;
  const step = Math.max(1, Math.ceil(0.5 / across)); // at least a number for each pixel of the canvas
  const begin = (edge, size) => step * Math.max(0, Math.floor(edge / size / step));
  const [first, start] = [begin(from - left, across), begin(-top, down)];
  const last = Math.min(width, Math.ceil((to - left) / across)), end = Math.min(height, Math.ceil((canvas.height - top) / down));
  const columns = Math.ceil((last - first) / step), lines = Math.ceil((end - start) / step);
  if (columns <= 0 || lines <= 0) return;
  const image = new ImageData(columns, lines), pixels = new Uint32Array(image.data.buffer);
  for (let line = 0, n = 0; line < lines; line++) {
    let k = ((start + line * step) * width + first) * stride;
    for (let column = 0; column < columns; column++, k += step * stride) pixels[n++] = colorAt(data, k);
  }
  [scratch.width, scratch.height] = [columns, lines];
  pad.putImageData(image, 0, 0);
  context.save();
  context.beginPath();
  context.rect(from, 0, to - from, canvas.height);
  context.clip();
  context.imageSmoothingEnabled = across < 1 || stride === 4;
  context.drawImage(scratch, left + first * across, top + start * down, columns * step * across, lines * step * down);
  context.restore();
}

const isBad = half => (half & 0x7c00) === 0x7c00;
function drawLayer(layer, from, to, over = false) {
  const grids = [thumbOf(layer), valuesGrid(layer)].filter(Boolean);
  for (const grid of over ? grids.slice(-1) : grids) {
    const table = colors(grid, layer, over), [second, third] = grid.stride === 1 ? [0, 0] : [1, 2];
    drawGrid(grid, from, to, (data, k) => {
      const red = data[k], green = data[k + second], blue = data[k + third];
      if (isBad(red) || isBad(green) || isBad(blue)) return BAD;
      return (table[red] & 0xff0000ff) | (table[green] & 0xff00) | (table[blue] & 0xff0000);
    });
  }
}

function drawDifference(first, second) {
  const grid = differences(first, second), heat = ofPair() && layerOf("difference"), scale = 255 * 2 ** view.stops / fullNow();
  if (heat) drawLayer({ ...heat, values: null }, 0, canvas.width);
  if (grid) drawGrid(grid, 0, canvas.width, (data, k) => data[k] < Infinity ? HEATS[Math.min(255, data[k] * scale) | 0] : BAD);
}

let due = false;
function draw() {
  if (due) return;
  due = true;
  requestAnimationFrame(() => { due = false; paint(); });
}

function paint() {
  const first = layerOf(view.first), second = layerOf(view.second) || first, { width, height } = canvas;
  const there = [first, second].every(layer => valuesGrid(layer) || thumbOf(layer));
  if (first && !there) return; // the last picture stays until this one is decoded
  context.clearRect(0, 0, width, height);
  if (!first) return;
  const zoom = zoomNow() * width / (canvas.clientWidth || 1), split = Math.round(view.split * width), mode = view.shown;
  camera = { zoom, x: view.x - width / zoom / 2, y: view.y - height / zoom / 2 };
  if (mode === "slider") {
    drawLayer(first, 0, split);
    drawLayer(second, split, width);
    context.fillStyle = "#fff";
    context.fillRect(split - 1, -camera.y * zoom, 2, first.size[1] * zoom);
  } else if (mode === "difference") drawDifference(first, second);
  else drawLayer(mode === "first" || (mode === "flicker" && !view.turn) ? first : second, 0, width);
  const overlay = layerOf(view.overlay);
  if (overlay) drawLayer(overlay, 0, width, true);
  if (view.pointer) read(...view.pointer);
  canvas.dataset.drawn = [first, second].every(layer => !layer.values || valuesGrid(layer)) ? view.item : "";
}

const ofPair = () => view.first === "a" && view.second === "b";
const fullNow = () => (ofPair() ? item().full : 0.25);

// ---- zoom and place

function fitZoom() {
  const layer = layerOf(view.first);
  return layer ? Math.min(canvas.clientWidth / layer.size[0], canvas.clientHeight / layer.size[1]) : 1;
}
const zoomNow = () => view.zoom || fitZoom();

function fit() {
  const layer = layerOf(view.first);
  view.zoom = 0;
  if (layer) [view.x, view.y] = [layer.size[0] / 2, layer.size[1] / 2];
  draw();
}

function zoomBy(factor, x = canvas.clientWidth / 2, y = canvas.clientHeight / 2) {
  const [px, py] = pixelAt(x, y), before = zoomNow();
  const after = clamped(before * factor, fitZoom() / 4, MAX_ZOOM);
  [view.zoom, view.x, view.y] = [after, px + (view.x - px) * before / after, py + (view.y - py) * before / after];
  draw();
}

const pixelAt = (x, y) => {
  const zoom = zoomNow();
  return [view.x + (x - canvas.clientWidth / 2) / zoom, view.y + (y - canvas.clientHeight / 2) / zoom];
};

function goTo([x, y]) {
  view.zoom = Math.max(zoomNow(), 8);
  [view.x, view.y] = [x + 0.5, y + 0.5];
  draw();
  read(x, y);
}

// ---- values under the pointer

const shortly = value => Number.isFinite(value) ? String(+value.toPrecision(4)) : String(value);

// The values of all layers at a pixel, those that are decoded already; they are read again when others are.
function read(x, y) {
  const layers = item().layers, [width, height] = layers.length ? layers[0].size : [0, 0];
  view.pointer = [x, y];
  if (x < 0 || y < 0 || x >= width || y >= height) return;
  const parts = layers.map(layer => {
    const { data, stride, numbers, box: [left, top, wide, high] } = valuesGrid(layer) || { box: [0, 0, 0, 0] };
    if (x < left || y < top || x >= left + wide || y >= top + high) return "";
    const start = ((y - top) * wide + x - left) * stride, values = Array.from(data.slice(start, start + stride), half => numbers[half]);
    return `${layer.title} ${values.map(shortly).join(" ")}${layer.key === "coc" ? " px" : ""}`;
  }).filter(Boolean);
  const none = layers.some(each => each.values) ? "values are kept of another part of this picture" : "a thumbnail: its values are not in this report";
  const names = parts.length ? `  (${(layerOf(view.first) || layers[0]).channels.join(" ")})` : "";
  $("readout").textContent = [`${x}, ${y}`, ...(parts.length ? parts : [none])].join("  ·  ") + names;
}

// ---- an item, and the ways to look at it

function choose(select, layers, key, none) {
  select.replaceChildren(...(none ? [new Option(none, "")] : []), ...layers.map(each => new Option(each.title, each.key)));
  select.value = key;
  select.disabled = select.options.length < 2;
}

function show(number, quietly) {
  if (!items[number]) return;
  const before = rows[view.item];
  if (before) before.removeAttribute("aria-current");
  view.item = number;
  const { layers } = item(), keys = pictured().map(each => each.key);
  rows[number].setAttribute("aria-current", "true");
  if (!quietly) rows[number].scrollIntoView({ block: "nearest" });
  if (!keys.includes(view.first) || !keys.includes(view.second) || (keys.includes("a") && !view.chosen)) {
    [view.first, view.second] = [keys[0] || "", keys[1] || keys[0] || ""];
  }
  if (!keys.includes(view.overlay)) view.overlay = "";
  choose($("first"), pictured(), view.first);
  choose($("second"), pictured(), view.second);
  choose($("overlay"), layers.filter(each => ["signed", "share"].includes(each.kind) && !["a", "b"].includes(each.key)), view.overlay, "none");
  const layer = layerOf(view.first), size = layer ? layer.size.join() : "";
  if (size !== view.size) fit();
  view.size = size;
  $("title").textContent = item().name;
  position();
  $("worst").disabled = !item().place;
  $("failure").textContent = "There is no picture of this item in the report.";
  $("failure").hidden = keys.length > 0;
  $("readout").textContent = "Point at the picture to read its values.";
  details();
  modes();
  if (!quietly) tell(`${item().name}: ${item().status}`);
}

// Number of the item; if names end in digits, as those of frames do, the number of the frame.
function position() {
  const frame = /(\d+)(?:\.[a-z]\w*)?$/i.exec(item().name);
  const place = `${view.order.indexOf(view.item) + 1} of ${view.order.length}`;
  $("position").textContent = frame ? `${place} · frame ${frame[1]}` : place;
}

function details() {
  const { facts, commands, facets } = item(), list = document.createElement("dl");
  for (const [term, text] of [...facts, ...Object.entries(facets)]) {
    const name = document.createElement("dt"), what = document.createElement("dd");
    name.textContent = term;
    what.textContent = text;
    list.append(name, what);
  }
  $("details").replaceChildren(...commands.map(each => commandLine(...each)), list);
}

const hasDifference = () => [view.first, view.second].every(key => layerOf(key)?.values) || Boolean(ofPair() && layerOf("difference"));

function modes() {
  const two = view.first !== view.second, able = {
    first: true, second: two, slider: two, flicker: two, difference: two && hasDifference(),
  };
  const mode = view.shown = able[view.mode] ? view.mode : "second";
  for (const button of document.querySelectorAll("[data-mode]")) {
    button.disabled = !able[button.dataset.mode] && button.dataset.mode !== "second";
    button.setAttribute("aria-pressed", String(button.dataset.mode === mode && !wiggles()));
  }
  const titles = ["first", "second"].map(name => (layerOf(view[name]) || { title: "" }).title);
  document.querySelector("[data-mode=first]").textContent = titles[0] || "A";
  document.querySelector("[data-mode=second]").textContent = titles[1] || "B";
  $("wiggle").disabled = !item().wiggle.length;
  $("wiggle").setAttribute("aria-pressed", String(wiggles()));
  $("split").hidden = mode !== "slider";
  $("legend").hidden = mode !== "difference";
  $("full").textContent = shortly(fullNow() / 2 ** view.stops);
  $("stops").textContent = `${view.stops > 0 ? "+" : ""}${view.stops} EV`;
  badge(titles, mode);
  clearInterval(flickering);
  flickering = mode === "flicker" ? setInterval(() => { view.turn = !view.turn; badge(titles, mode); draw(); }, PERIOD) : 0;
  draw();
}

function badge(titles, mode) {
  const layer = layerOf(mode === "flicker" ? (view.turn ? view.second : view.first) : view.second);
  const only = layer && !layer.values ? " (thumbnail)" : "";
  const words = { first: titles[0], second: titles[1], slider: titles.join(" | "), difference: `|${titles[1]} − ${titles[0]}|`, flicker: titles[view.turn ? 1 : 0] };
  $("badge").textContent = words[mode] + only;
  canvas.setAttribute("aria-label", `${item().name}: ${words[mode]}`);
}

function setMode(mode) {
  view.mode = mode;
  modes();
  tell($("badge").textContent);
}

// Whether the left and the right view flicker.
const wiggles = () => view.shown === "flicker" && item().wiggle.length > 0 && [view.first, view.second].join() === item().wiggle.join();

function wiggle() {
  if (!item().wiggle.length) return;
  [view.mode, view.first, view.second] = wiggles() ? ["slider", "", ""] : ["flicker", ...item().wiggle];
  show(view.item, true);
}

function expose(stops) {
  view.stops = clamped(stops, -20, 20);
  $("exposure").value = view.stops;
  modes();
}

function step(by) {
  const place = view.order.indexOf(view.item);
  const next = view.order[place < 0 ? 0 : clamped(place + by, 0, view.order.length - 1)];
  if (next !== undefined && next !== view.item) show(next);
}

function play() {
  $("play").setAttribute("aria-pressed", String(!film));
  if (film) { clearInterval(film); film = 0; draw(); return; }
  const after = steps => view.order[(view.order.indexOf(view.item) + steps) % view.order.length];
  film = setInterval(() => {
    if (!view.order.length) return; // nothing passes the filter
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
    if (!rule) return each => `${each.name} ${each.words} ${Object.values(each.facets).join(" ")}`.toLowerCase().includes(word);
    const [, name, sign, bound] = rule, limit = Number(bound);
    return each => {
      const value = numeric(each.metrics[name]);
      return { "<": value < limit, "<=": value <= limit, ">": value > limit, ">=": value >= limit }[sign];
    };
  });
  const statuses = new Set([...document.querySelectorAll("[name=status]:checked")].map(each => each.value));
  const facets = [...document.querySelectorAll("select.facet")].filter(each => each.value);
  return each => statuses.has(each.status) && facets.every(f => each.facets[f.dataset.facet] === f.value) && tests.every(test => test(each));
}

let sorting = { by: "rank", down: false };
const collator = new Intl.Collator("en", { numeric: true });

function compare(m, n) {
  const { by } = sorting;
  if (by === "rank") return m - n;
  if (by === "name") return collator.compare(items[m].name, items[n].name);
  const [a, b] = [m, n].map(each => numeric(items[each].metrics[by]));
  if (Number.isNaN(a) && Number.isNaN(b)) return collator.compare(items[m].facets[by] || "", items[n].facets[by] || "");
  return Number.isNaN(a) ? 1 : Number.isNaN(b) ? -1 : a - b || 0;
}

function list_rows() {
  const matches = matcher(), sorted = items.map((_, n) => n).sort((m, n) => (sorting.down ? -1 : 1) * compare(m, n) || m - n);
  view.order = sorted.filter(n => matches(items[n]));
  const shown = new Set(view.order);
  rows.forEach((row, n) => { row.hidden = !shown.has(n); });
  body.append(...sorted.map(n => rows[n]));
  $("nothing").hidden = view.order.length > 0;
  $("shown").textContent = view.order.length < items.length ? `${view.order.length} of ${items.length}` : "";
  for (const button of document.querySelectorAll("[data-sort]")) {
    const own = button.dataset.sort === sorting.by;
    button.parentElement.setAttribute("aria-sort", own ? (sorting.down ? "descending" : "ascending") : "none");
  }
  if (view.order.length && !shown.has(view.item)) show(view.order[0], true);
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
    addressOf(target.dataset.payload).then(address => { target.src = address; });
  }
}, { root: null, rootMargin: "200px" });

// ---- what people do

const KEYS = {
  ArrowLeft: () => step(-1), ArrowUp: () => step(-1), ArrowRight: () => step(1), ArrowDown: () => step(1),
  1: () => setMode("first"), 2: () => setMode("second"), s: () => setMode("slider"),
  f: () => setMode(view.mode === "flicker" ? "slider" : "flicker"),
  d: () => setMode(view.mode === "difference" ? "slider" : "difference"),
  w: wiggle, c: overlay, "[": () => expose(view.stops - 0.5), "]": () => expose(view.stops + 0.5),
  "+": () => zoomBy(1.5), "=": () => zoomBy(1.5), "-": () => zoomBy(1 / 1.5), 0: fit,
  g: () => item().place && goTo(item().place), " ": play,
  "/": () => $("filter").focus(), "?": () => $("help").showModal(),
};

function overlay() {
  const options = [...$("overlay").options].map(each => each.value);
  view.overlay = options[(options.indexOf(view.overlay) + 1) % options.length];
  $("overlay").value = view.overlay;
  tell(`Overlay: ${view.overlay || "none"}`);
  draw();
}

listen(KEYS, ({ target, key }) => {
  const typing = target.matches("input[type=search], select") || (target.matches("input[type=range]") && key.startsWith("Arrow"));
  if (typing && key === "Escape") target.blur();
  return typing || !item() || (key === " " && target.matches("button, input, summary, a"));
});

body.addEventListener("click", event => {
  const row = event.target.closest("tr");
  if (row) show(Number(row.dataset.item), true);
});
for (const button of document.querySelectorAll("[data-sort]")) button.onclick = () => sort(button.dataset.sort);
for (const button of document.querySelectorAll("[data-mode]")) button.onclick = () => setMode(button.dataset.mode);
$("filters").addEventListener("input", list_rows);
$("filters").addEventListener("submit", event => event.preventDefault());
const CLICKS = {
  previous: () => step(-1), next: () => step(1), play, wiggle, fit, in: () => zoomBy(1.5), out: () => zoomBy(1 / 1.5), worst: KEYS.g,
};
for (const [name, act] of Object.entries(CLICKS)) $(name).onclick = act;
$("exposure").oninput = event => expose(Number(event.target.value));
$("split").oninput = event => { view.split = event.target.value / 1000; draw(); };
$("overlay").onchange = event => { view.overlay = event.target.value; draw(); };
for (const name of ["first", "second"]) $(name).onchange = event => {
  [view[name], view.chosen] = [event.target.value, true];
  modes();
};

let drag = null;
canvas.addEventListener("pointerdown", event => {
  if (event.button) return;
  const near = view.shown === "slider" && Math.abs(event.offsetX - view.split * canvas.clientWidth) < 12;
  drag = { near, x: event.offsetX, y: event.offsetY };
  canvas.setPointerCapture(event.pointerId);
});
canvas.addEventListener("pointermove", event => {
  const { offsetX: x, offsetY: y } = event;
  if (drag && drag.near) {
    view.split = clamped(x / canvas.clientWidth, 0, 1);
    $("split").value = 1000 * view.split;
    draw();
  } else if (drag) {
    const zoom = zoomNow();
    [view.zoom, view.x, view.y] = [zoom, view.x - (x - drag.x) / zoom, view.y - (y - drag.y) / zoom];
    [drag.x, drag.y] = [x, y];
    draw();
  } else if (item()) read(...pixelAt(x, y).map(Math.floor));
});
for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { drag = null; });
canvas.addEventListener("dblclick", fit);
canvas.addEventListener("wheel", event => {
  event.preventDefault();
  zoomBy(Math.exp(-event.deltaY / 400), event.offsetX, event.offsetY);
}, { passive: false });

new ResizeObserver(() => {
  const ratio = devicePixelRatio || 1;
  canvas.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
  canvas.height = Math.max(1, Math.round(canvas.clientHeight * ratio));
  draw();
}).observe(canvas);

const gradient = heats.map(color => `rgb(${color.map(each => 255 * each).join(" ")})`);
$("legend").querySelector("i").style.background = `linear-gradient(90deg, ${gradient})`;
for (const image of document.querySelectorAll("img[data-payload]")) watcher.observe(image);
list_rows();
})();
