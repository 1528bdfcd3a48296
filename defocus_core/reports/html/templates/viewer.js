// What all pages share: a viewer of the values of pictures on a 2D canvas, keys, and commands to copy.
"use strict";
const $ = id => document.getElementById(id);
const { items, heats, signed, nonfinite, ...own } = JSON.parse($("data").textContent);
// What is shown, and how; it stays while items change. Place and zoom are in px of the picture.
const view = {
  item: -1, mode: "slider", shown: "slider", first: "", second: "", stops: 0, split: 0.5,
  zoom: 0, x: 0, y: 0, size: "", turn: false, film: 0, mark: null,
};
const MAX_ZOOM = 64, PERIOD = 500;
let flickering = 0;
const item = () => items[view.item];
const layerOf = key => item() && item().layers.find(layer => layer.key === key);
const pictured = () => item() ? item().layers.filter(layer => layer.key !== "difference") : [];
const clamped = (value, low, high) => Math.max(low, Math.min(high, value));

// The address of a picture: its payload is base64 in an element of the page.
const addressOf = name => {
  const text = $(name).textContent;
  return `data:image/${text.startsWith("iVBOR") ? "png" : "jpeg"};base64,${text}`;
};

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
  const packed = Uint8Array.from(atob($(payload).textContent), letter => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
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
  const image = new Image(), { canvas: shown, context: drawn } = blank();
  image.src = addressOf(layer.thumbnail);
  await image.decode();
  const [width, height] = [shown.width, shown.height] = [image.naturalWidth, image.naturalHeight];
  drawn.drawImage(image, 0, 0);
  const { data } = drawn.getImageData(0, 0, width, height);
  const [low, high] = ["light", "heat"].includes(layer.kind) ? [0, 1] : layer.ends;
  const numbers = Float64Array.from({ length: 256 }, (_, grey) => low + grey / 255 * (high - low));
  return { data, width, height, stride: 4, box: [0, 0, ...layer.size], gamma: null, scale: "thumbnail", numbers };
}).made;
const valuesSoon = (layer, owner = item()) => soon(layer.values.payload, async () => {
  const { box, size: [width, height], scale, ends } = layer.values;
  const numbers = HALVES.map((each, n) => ends ? ends[0] + n / 65535 * (ends[1] - ends[0]) : each * scale);
  const data = await unpack(owner, layer);
  return { data, width, height, stride: layer.channels.length, box, gamma: layer.gamma, scale: ends?.join() ?? scale, numbers };
});
const valuesGrid = layer => layer && layer.values && !(view.film && layer.thumbnail) && valuesSoon(layer).made;
const bestGrid = layer => valuesGrid(layer) || thumbOf(layer);

// The numbers of a grid at a pixel of the picture; none outside.
function numbersAt({ data, stride, width, height, numbers, box: [left, top, wide, high] }, x, y) {
  if (x < left || y < top || x >= left + wide || y >= top + high) return [];
  const column = Math.floor((x - left + 0.5) * width / wide), line = Math.floor((y - top + 0.5) * height / high);
  const start = (line * width + column) * stride;
  return Array.from(data.slice(start, start + stride), n => numbers[n]);
}

// The greatest difference of each pixel: of two layers, or of the layer that has it where halves do not tell it.
function differences(first, second) {
  const heat = ofPair() && layerOf("difference"), lone = Boolean(heat?.values);
  const [a, b] = lone ? [null, valuesGrid(heat)] : [first, second].map(heat ? valuesGrid : bestGrid);
  if (!b || !(lone || (a && String([a.box, a.data.length]) === String([b.box, b.data.length])))) return null;
  return soon([first, second].map(layer => layer.values?.payload || layer.thumbnail).join(), async () => {
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

// The colour of each number at the exposure, as a table.
function colors(grid, { kind, ends: [low, high] }) {
  const name = [kind, low, high, grid.gamma, grid.scale, view.stops].join(), gain = kind === "heat" ? 1 : 2 ** view.stops;
  const share = v => clamped((v - low) / (high - low) * gain, 0, 1), most = v => clamped(Math.abs(v) / high * gain, 0, 1);
  const grey = ["light", "heat"].includes(kind) ? v => toScreen(gain * toLight(Math.max(v, 0), grid.gamma)) : share;
  const colorOf = kind === "signed"
    ? v => mixed(signed[1], signed[v < 0 ? 0 : 2], most(v))
    : v => 0x1010101 * Math.round(255 * grey(v)) | 0xff000000;
  return kept(tables, name, 8, () => Uint32Array.from(grid.numbers, v => Number.isFinite(v) ? colorOf(v) : BAD));
}

// ---- the picture: values lie in a window of it; around it the thumbnail shows

// A canvas that no graphics card draws: as fast without one.
function blank(canvas = document.createElement("canvas")) {
  return { canvas, context: canvas.getContext("2d", { willReadFrequently: true }) };
}
const { canvas, context } = blank($("canvas")), { canvas: scratch, context: pad } = blank();
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

function drawLayer(layer, from, to) {
  for (const grid of [thumbOf(layer), valuesGrid(layer)].filter(Boolean)) {
    const table = colors(grid, layer), [second, third] = grid.stride === 1 ? [0, 0] : [1, 2];
    drawGrid(grid, from, to, (data, k) => {
      const red = table[data[k]], green = table[data[k + second]], blue = table[data[k + third]];
      if (red === BAD || green === BAD || blue === BAD) return BAD;
      return (red & 0xff0000ff) | (green & 0xff00) | (blue & 0xff0000);
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
  if (first && ![first, second].every(bestGrid)) return; // the last picture stays until this one is decoded
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
  if (view.mark) ring(...view.mark);
  if (view.pointer) read(...view.pointer);
  canvas.dataset.drawn = [first, second].every(layer => !layer.values || valuesGrid(layer)) ? view.item : "";
}

// A ring about a pixel, seen on light and dark.
function ring(x, y) {
  for (const [style, line] of [["#000", 4], ["#fff", 2]]) {
    [context.strokeStyle, context.lineWidth] = [style, line * devicePixelRatio];
    context.beginPath();
    context.arc((x + 0.5 - camera.x) * camera.zoom, (y + 0.5 - camera.y) * camera.zoom, 10 * devicePixelRatio, 0, 7);
    context.stroke();
  }
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
    const grid = valuesGrid(layer), values = grid ? numbersAt(grid, x, y) : [];
    const said = values.map(value => shortly(layer.values.inverse ? 1 / value : value));
    return said.length ? `${layer.title} ${said.join(" ")} ${layer.unit}`.trim() : "";
  }).filter(Boolean);
  const none = layers.some(each => each.values) ? "values are kept of another part of this picture" : "a thumbnail: its values are not in this report";
  const names = parts.length ? `  (${(layerOf(view.first) || layers[0]).channels.join(" ")})` : "";
  $("readout").textContent = [`${x}, ${y}`, ...(parts.length ? parts : [none])].join("  ·  ") + names;
}

// ---- an item, and the ways to look at it

function offer(select, layers, key) {
  select.replaceChildren(...layers.map(each => new Option(each.title, each.key)));
  select.value = key;
  select.disabled = select.options.length < 2;
}

function showItem(number) {
  view.item = number;
  canvas.dataset.drawn = "";
  const { layers } = item(), keys = pictured().map(each => each.key);
  if (!keys.includes(view.first) || !keys.includes(view.second) || (keys.includes("a") && !view.chosen)) {
    [view.first, view.second] = [keys[0] || "", keys[1] || keys[0] || ""];
  }
  offer($("first"), pictured(), view.first);
  offer($("second"), pictured(), view.second);
  const layer = layerOf(view.first), size = layer ? layer.size.join() : "";
  if (size !== view.size) fit();
  view.size = size;
  $("title").textContent = item().name;
  $("worst").disabled = !item().place;
  $("failure").textContent = "There is no picture of this item in the report.";
  $("failure").hidden = keys.length > 0;
  $("readout").textContent = "Point at the picture to read its values.";
  const { facts, commands } = item(), list = document.createElement("dl");
  list.append(...facts.flatMap(([term, text]) => [textIn("dt", term), textIn("dd", text)]));
  $("details").replaceChildren(...commands.map(each => commandLine(...each)), list);
  modes();
}

const textIn = (tag, text) => Object.assign(document.createElement(tag), { textContent: text });
const hasDifference = () => Boolean(ofPair() && layerOf("difference"))
  || [view.first, view.second].every(key => layerOf(key)?.values || (!ofPair() && layerOf(key)?.thumbnail));

function modes() {
  const two = view.first !== view.second, able = {
    first: true, second: two, slider: two, flicker: two, difference: two && hasDifference(),
  };
  const mode = view.shown = able[view.mode] ? view.mode : "second";
  for (const button of document.querySelectorAll("[data-mode]")) {
    button.disabled = !able[button.dataset.mode] && button.dataset.mode !== "second";
    button.setAttribute("aria-pressed", String(button.dataset.mode === mode));
  }
  const titles = ["first", "second"].map(name => (layerOf(view[name]) || { title: "" }).title);
  document.querySelector("[data-mode=first]").textContent = titles[0] || "A";
  document.querySelector("[data-mode=second]").textContent = titles[1] || "B";
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
  view.mode = view.mode === mode && ["flicker", "difference"].includes(mode) ? "slider" : mode;
  modes();
  tell($("badge").textContent);
}

function expose(stops) {
  view.stops = clamped(stops, -20, 20);
  $("exposure").value = view.stops;
  modes();
}

const tell = words => { $("news").textContent = words; };

// A command line with its title, and a button that copies it.
function commandLine(title, line) {
  const box = $("command").content.firstElementChild.cloneNode(true), [label, code, copy] = box.children;
  [label.textContent, code.textContent] = [title, line];
  copy.setAttribute("aria-label", `Copy: ${title}`);
  copy.onclick = async () => {
    try {
      await navigator.clipboard.writeText(line); // which no page has that came without encryption
      copy.textContent = "Copied";
      setTimeout(() => { copy.textContent = "Copy"; }, 1500);
    } catch {
      getSelection().selectAllChildren(code); // to be copied by hand
    }
  };
  return box;
}

// ---- what people do

let clickAt = () => {}; // what a page does with a pixel that is clicked
const KEYS = {
  1: () => setMode("first"), 2: () => setMode("second"), s: () => setMode("slider"),
  f: () => setMode("flicker"), d: () => setMode("difference"),
  "[": () => expose(view.stops - 0.5), "]": () => expose(view.stops + 0.5),
  "+": () => zoomBy(1.5), "=": () => zoomBy(1.5), "-": () => zoomBy(1 / 1.5), 0: fit,
  g: () => item().place && goTo(item().place), "?": () => $("help").showModal(),
};

// Keys of the viewer and of the page, but where an element takes the key itself.
document.addEventListener("keydown", event => {
  const { target, key } = event;
  if (event.ctrlKey || event.metaKey || event.altKey || $("help").open || !item()) return;
  const typing = target.matches("input[type=search], select") || (target.matches("input[type=range]") && key.startsWith("Arrow"));
  if (typing && key === "Escape") target.blur();
  const act = KEYS[key.length === 1 ? key.toLowerCase() : key];
  if (!act || typing || (key === " " && target.matches("button, input, summary, a"))) return;
  event.preventDefault();
  act();
});

for (const button of document.querySelectorAll("[data-mode]")) button.onclick = () => setMode(button.dataset.mode);
const CLICKS = { fit, in: KEYS["+"], out: KEYS["-"], worst: KEYS.g, "help-button": KEYS["?"] };
for (const [name, act] of Object.entries(CLICKS)) $(name).onclick = act;
$("exposure").oninput = event => expose(Number(event.target.value));
$("split").oninput = event => { view.split = event.target.value / 1000; draw(); };
for (const name of ["first", "second"]) $(name).onchange = event => {
  [view[name], view.chosen] = [event.target.value, true];
  modes();
};

let drag = null; // while a button is down; a click has moved nothing
canvas.addEventListener("pointerdown", ({ button, offsetX: x, offsetY: y, pointerId }) => {
  if (button) return;
  const near = view.shown === "slider" && Math.abs(x - view.split * canvas.clientWidth) < 12;
  drag = { near, x, y, moved: false };
  canvas.setPointerCapture(pointerId);
});
canvas.addEventListener("pointermove", ({ offsetX: x, offsetY: y }) => {
  if (!drag && item()) read(...pixelAt(x, y).map(Math.floor));
  if (!drag || !(drag.moved ||= Math.hypot(x - drag.x, y - drag.y) > 2)) return;
  if (drag.near) {
    view.split = clamped(x / canvas.clientWidth, 0, 1);
    $("split").value = 1000 * view.split;
  } else {
    const zoom = zoomNow();
    [view.zoom, view.x, view.y] = [zoom, view.x - (x - drag.x) / zoom, view.y - (y - drag.y) / zoom];
    [drag.x, drag.y] = [x, y];
  }
  draw();
});
canvas.addEventListener("pointerup", ({ offsetX: x, offsetY: y }) => {
  if (drag && !drag.moved && !drag.near) clickAt(...pixelAt(x, y).map(Math.floor));
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

$("worst").hidden = !items.some(each => each.place);
const gradient = heats.map(color => `rgb(${color.map(each => 255 * each).join(" ")})`);
$("legend").querySelector("i").style.background = `linear-gradient(90deg, ${gradient})`;
