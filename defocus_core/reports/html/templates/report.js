// The report: a table to sort and filter, and a viewer of the values of pictures (WebGL 2).
(() => {
const { items, heats, signed, nonfinite } = JSON.parse($("data").textContent);
const body = document.querySelector("#rows tbody");
const rows = [...body.rows];
// What is shown, and how; it stays while items change. Place and zoom are in px of the picture.
const view = {
  item: -1, order: items.map((_, n) => n), mode: "slider", shown: "slider", wiggling: false, first: "", second: "",
  overlay: "", stops: 0, split: 0.5, zoom: 0, x: 0, y: 0, size: "", turn: false,
};
const MAX_ZOOM = 64, PERIOD = 500, FRAME = 1000 / 12;
let film = 0, flickering = 0;
const item = () => items[view.item];
const layerOf = key => item() && item().layers.find(layer => layer.key === key);
const pictured = () => item() ? item().layers.filter(layer => layer.key !== "difference") : [];

async function inflated(packed, size) {
  const stream = new DecompressionStream("deflate"), writer = stream.writable.getWriter();
  const written = writer.write(packed).then(() => writer.close());
  const bytes = new Uint8Array(size), reader = stream.readable.getReader();
  for (let place = 0; ;) {
    const { done, value } = await reader.read();
    if (done) break;
    bytes.set(value, place);
    place += value.length;
  }
  await written;
  return bytes;
}

// Bits of halves: differences to the left neighbour or to another layer; low bytes, then high ones.
async function unpack(owner, layer) {
  const { payload, size: [width, height], base } = layer.values, channels = layer.channels.length;
  const count = width * height, total = count * channels, bits = new Uint16Array(total);
  const bytes = await inflated(await bytesOf(payload), 2 * total);
  const other = base && (await valuesOf(owner, owner.layers.find(each => each.key === base)));
  for (let channel = 0, n = 0; channel < channels; channel++) {
    for (let pixel = 0, place = channel; pixel < count; pixel++, n++, place += channels) {
      const before = other ? other[place] : pixel % width ? bits[place - channels] : 0;
      bits[place] = before + bytes[n] + (bytes[n + total] << 8);
    }
  }
  return bits;
}

const unpacked = new Map(); // the last few layers, by payload
function valuesOf(owner, layer) {
  return kept(unpacked, layer.values.payload, 16, () => unpack(owner, layer), () => {});
}

function kept(map, key, most, make, drop) {
  if (!map.has(key)) map.set(key, make());
  const value = map.get(key);
  map.delete(key);
  map.set(key, value); // the last used is the last
  for (const [old, oldest] of map) {
    if (map.size <= most) break;
    map.delete(old);
    drop(oldest);
  }
  return value;
}

function number(half) {
  const exponent = (half >> 10) & 31, fraction = half & 1023, sign = half & 0x8000 ? -1 : 1;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : fraction * 2 ** -24);
}

// ---- the picture, drawn by one shader: slots 0 and 1 are the pictures, 2 the overlay, 3 the
// difference. Values lie in a window of the picture; around it the thumbnail shows.

const VERTEX = `#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1, 0, 1); }`;
const list = colors => colors.map(color => `vec3(${color.map(each => each.toFixed(4))})`).join();
const FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
uniform sampler2D thumb0, thumb1, thumb2, thumb3, value0, value1, value2, value3;
struct Slot { int kind; bool thumb, values, lone; vec2 size; vec4 box; float scale, gamma; vec2 ends; };
uniform Slot slots[4];
uniform int mode;       // 0 first, 1 second, 2 slider, 3 difference
uniform vec2 origin;    // px of the picture at the left top of the canvas
uniform float zoom, height, split, gain, full;
out vec4 color;
const vec3 heats[${heats.length}] = vec3[](${list(heats)});
const vec3 ends[3] = vec3[](${list(signed)});
const vec3 bad = vec3(${nonfinite.map(each => each.toFixed(1))});

vec3 thumb(int s, vec2 at) {
  return s == 0 ? texture(thumb0, at).rgb : s == 1 ? texture(thumb1, at).rgb
    : s == 2 ? texture(thumb2, at).rgb : texture(thumb3, at).rgb;
}
vec3 value(int s, vec2 at) {
  vec4 t = s == 0 ? texture(value0, at) : s == 1 ? texture(value1, at)
    : s == 2 ? texture(value2, at) : texture(value3, at);
  return (slots[s].lone ? t.rrr : t.rgb) * slots[s].scale;
}
bool within(vec2 p, vec4 box) {
  return all(greaterThanEqual(p, box.xy)) && all(lessThan(p, box.xy + box.zw));
}
bool valued(int s, vec2 p) { return slots[s].values && within(p, slots[s].box); }
bool finite(vec3 v) { return !any(isnan(v)) && !any(isinf(v)); }
vec3 to_light(vec3 v, float gamma) {
  vec3 curve = pow((max(v, 0.0) + 0.055) / 1.055, vec3(2.4));
  if (gamma == 0.0) return mix(curve, v / 12.92, lessThanEqual(v, vec3(0.04045)));
  return gamma == 1.0 ? v : pow(max(v, 0.0), vec3(gamma));
}
vec3 to_screen(vec3 v) {
  v = clamp(v, 0.0, 1.0);
  return mix(1.055 * pow(v, vec3(1.0 / 2.4)) - 0.055, v * 12.92, lessThanEqual(v, vec3(0.0031308)));
}
vec3 fetched(int s, vec2 p) {
  if (valued(s, p)) return value(s, (p - slots[s].box.xy) / slots[s].box.zw);
  vec3 t = thumb(s, p / slots[s].size);
  if (slots[s].kind == 0) return t;
  return vec3(mix(slots[s].ends.x, slots[s].ends.y, t.r));
}
vec3 of_sign(float v, float most) {
  return mix(ends[1], v < 0.0 ? ends[0] : ends[2], clamp(abs(v) / most * gain, 0.0, 1.0));
}
vec4 shown(int s, vec2 p) {
  if (!within(p, vec4(0, 0, slots[s].size)) || !(valued(s, p) || slots[s].thumb)) return vec4(0);
  vec3 v = fetched(s, p);
  if (!finite(v)) return vec4(bad, 1);
  Slot slot = slots[s];
  if (slot.kind == 0) return vec4(to_screen(gain * to_light(v, valued(s, p) ? slot.gamma : 0.0)), 1);
  if (slot.kind == 1) return vec4(of_sign(v.r, slot.ends.y), 1);
  return vec4(vec3(clamp((v.r - slot.ends.x) / (slot.ends.y - slot.ends.x) * gain, 0.0, 1.0)), 1);
}
vec4 heat(vec2 p) {
  if (!within(p, vec4(0, 0, slots[0].size))) return vec4(0);
  vec3 d;
  bool apart = false;
  if (valued(3, p)) {
    d = fetched(3, p);
    apart = !finite(d);
  } else if (valued(0, p) && valued(1, p)) {
    vec3 a = fetched(0, p), b = fetched(1, p);
    d = b - a;
    bvec3 both = bvec3(isnan(a.r) && isnan(b.r), isnan(a.g) && isnan(b.g), isnan(a.b) && isnan(b.b));
    d = mix(d, vec3(0), both);
    d = mix(d, vec3(0), equal(a, b));
    apart = !finite(d);
  } else return slots[3].thumb ? vec4(thumb(3, p / slots[3].size), 1) : vec4(0);
  if (apart) return vec4(bad, 1);
  d = abs(d);
  float place = clamp(max(d.r, max(d.g, d.b)) / full * gain, 0.0, 1.0) * ${heats.length - 1}.0;
  int low = min(int(place), ${heats.length - 2});
  return vec4(mix(heats[low], heats[low + 1], place - float(low)), 1);
}
void main() {
  vec2 at = vec2(gl_FragCoord.x, height - gl_FragCoord.y), p = origin + at / zoom;
  bool right = at.x > split;
  color = mode == 3 ? heat(p) : shown(mode == 0 || (mode == 2 && !right) ? 0 : 1, p);
  bool over = slots[2].kind >= 0 && within(p, vec4(0, 0, slots[2].size));
  if (color.a > 0.0 && over && (valued(2, p) || slots[2].thumb)) {
    float v = fetched(2, p).r, most = slots[2].ends.y;
    if (slots[2].kind == 1)
      color.rgb = mix(color.rgb, v < 0.0 ? ends[0] : ends[2], 0.75 * clamp(abs(v) / most, 0.0, 1.0));
    else color.rgb = mix(heats[3], color.rgb, clamp((v - slots[2].ends.x) / (most - slots[2].ends.x), 0.2, 1.0));
  }
  if (mode == 2 && abs(at.x - split) < 1.0 && color.a > 0.0) color = vec4(1);
  color.rgb *= color.a;
}`;

const canvas = $("canvas");
const gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
let program = null;
const textures = new Map();
const KINDS = { light: 0, signed: 1, share: 2, plain: 3, heat: 4 };

function start() {
  if (!gl) return fail("This browser has no WebGL 2: pictures cannot be shown. The table and the thumbnails can.");
  program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
    const shaders = gl.getAttachedShaders(program).map(each => gl.getShaderInfoLog(each));
    throw new Error(`shader: ${gl.getProgramInfoLog(program)} ${shaders}`);
  }
  gl.useProgram(program);
  for (let slot = 0; slot < 4; slot++) {
    gl.uniform1i(at(`thumb${slot}`), slot);
    gl.uniform1i(at(`value${slot}`), slot + 4);
  }
}

const places = new Map();
const at = name => {
  if (!places.has(name)) places.set(name, gl.getUniformLocation(program, name));
  return places.get(name);
};

function fail(words) {
  $("failure").textContent = words;
  $("failure").hidden = false;
}

function texture(fill, magnify) {
  const made = gl.createTexture();
  gl.activeTexture(gl.TEXTURE15);
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
  fill();
  for (const [name, value] of [
    [gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, magnify],
    [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
  ]) gl.texParameteri(gl.TEXTURE_2D, name, value);
  return made;
}

// A texture, or null while it is being made; the picture is drawn again when it is there.
function textureOf(payload, make) {
  const drop = old => old.made && gl.deleteTexture(old.made);
  return kept(textures, payload, 24, () => {
    const entry = { made: null };
    make().then(made => { entry.made = made; draw(); }, error => fail(`A picture cannot be shown: ${error.message}`));
    return entry;
  }, drop).made;
}

async function thumbTexture(payload) {
  const image = new Image();
  image.src = await addressOf(payload);
  await image.decode();
  return texture(() => gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, image), gl.LINEAR);
}

async function valueTexture(owner, layer) {
  const bits = await valuesOf(owner, layer), [width, height] = layer.values.size;
  const [inner, format] = layer.channels.length === 1 ? [gl.R16F, gl.RED] : [gl.RGB16F, gl.RGB];
  return texture(() => gl.texImage2D(gl.TEXTURE_2D, 0, inner, width, height, 0, format, gl.HALF_FLOAT, bits), gl.NEAREST);
}

// Hand a layer to the shader; whether there is something of it to show. A film shows thumbnails.
function fillSlot(slot, layer) {
  const name = `slots[${slot}].`;
  const use = (unit, made) => { gl.activeTexture(gl.TEXTURE0 + unit); gl.bindTexture(gl.TEXTURE_2D, made); };
  gl.uniform1i(at(`${name}kind`), layer ? KINDS[layer.kind] : -1);
  const thumb = layer && layer.thumbnail && textureOf(layer.thumbnail, () => thumbTexture(layer.thumbnail));
  const owner = item(), values = layer && !(film && layer.thumbnail) && layer.values;
  const value = values && textureOf(values.payload, () => valueTexture(owner, layer));
  gl.uniform1i(at(`${name}thumb`), thumb ? 1 : 0);
  gl.uniform1i(at(`${name}values`), value ? 1 : 0);
  use(slot, thumb || null);
  use(slot + 4, value || null);
  if (!layer) return false;
  gl.uniform1i(at(`${name}lone`), layer.channels.length === 1 ? 1 : 0);
  if (value) {
    gl.uniform4f(at(`${name}box`), ...values.corner, ...values.size);
    gl.uniform1f(at(`${name}scale`), values.scale);
  }
  gl.uniform2f(at(`${name}size`), ...layer.size);
  gl.uniform1f(at(`${name}gamma`), layer.gamma === null ? 0 : layer.gamma);
  gl.uniform2f(at(`${name}ends`), ...layer.ends);
  return Boolean(thumb || value);
}

let due = false;
function draw() {
  if (due || !program) return;
  due = true;
  requestAnimationFrame(() => { due = false; paint(); });
}

function paint() {
  const first = layerOf(view.first), second = layerOf(view.second) || first;
  const ready = !first || [fillSlot(0, first), fillSlot(1, second)].every(Boolean);
  if (!ready) return; // the last picture stays until this one is decoded
  gl.viewport(0, 0, canvas.width, canvas.height);
  gl.clearColor(0, 0, 0, 0);
  gl.clear(gl.COLOR_BUFFER_BIT);
  if (!first) return;
  fillSlot(2, layerOf(view.overlay));
  fillSlot(3, ofPair() ? layerOf("difference") : undefined);
  const ratio = canvas.width / (canvas.clientWidth || 1), zoom = zoomNow() * ratio;
  const mode = { first: 0, second: 1, slider: 2, difference: 3, flicker: view.turn ? 1 : 0 }[view.shown];
  gl.uniform1i(at("mode"), mode);
  gl.uniform2f(at("origin"), view.x - canvas.width / zoom / 2, view.y - canvas.height / zoom / 2);
  gl.uniform1f(at("zoom"), zoom);
  gl.uniform1f(at("height"), canvas.height);
  gl.uniform1f(at("split"), view.split * canvas.width);
  gl.uniform1f(at("gain"), 2 ** view.stops);
  gl.uniform1f(at("full"), fullNow());
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  canvas.dataset.drawn = [first, second].every(layer => !layer.values || textures.get(layer.values.payload)?.made) ? view.item : "";
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
  const after = Math.min(MAX_ZOOM, Math.max(fitZoom() / 4, before * factor));
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

async function valuesAt(layer, x, y) {
  const { corner: [left, top], size: [width, height], scale } = layer.values;
  if (x < left || y < top || x >= left + width || y >= top + height) return null;
  const bits = await valuesOf(item(), layer), count = layer.channels.length;
  const start = ((y - top) * width + x - left) * count;
  return [...bits.slice(start, start + count)].map(each => number(each) * scale);
}

let latest = 0;
async function read(x, y) {
  const layers = item().layers, turn = ++latest, parts = [`${x}, ${y}`];
  const whole = layers[0] && layers[0].size;
  if (!whole || x < 0 || y < 0 || x >= whole[0] || y >= whole[1]) return;
  for (const layer of layers) {
    if (!layer.values) continue;
    const values = await valuesAt(layer, x, y);
    if (values) parts.push(`${layer.title} ${values.map(shortly).join(" ")}${layer.key === "coc" ? " px" : ""}`);
  }
  if (turn !== latest) return;
  const names = (layerOf(view.first) || layers[0]).channels.join(" ");
  $("readout").textContent = parts.length > 1 ? `${parts.join("  ·  ")}  (${names})`
    : `${x}, ${y}  ·  ${layers.some(each => each.values) ? "values are kept of another part of this picture" : "a thumbnail: its values are not in this report"}`;
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
  const { layers, wiggle } = item(), keys = pictured().map(each => each.key);
  rows[number].setAttribute("aria-current", "true");
  if (!quietly) rows[number].scrollIntoView({ block: "nearest" });
  if (view.wiggling && wiggle.length) [view.first, view.second] = wiggle;
  else if (view.wiggling || !keys.includes(view.first) || !keys.includes(view.second) || keys.includes("a") && !view.chosen) {
    view.wiggling = false;
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
  if (program) {
    $("failure").textContent = "There is no picture of this item in the report.";
    $("failure").hidden = keys.length > 0;
  }
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
  const { words, status, facts, commands, metrics, facets } = item();
  const terms = [...facts, ...Object.entries(facets)];
  const list = document.createElement("dl");
  for (const [term, text] of terms) {
    const name = document.createElement("dt"), what = document.createElement("dd");
    name.textContent = term;
    what.textContent = text;
    list.append(name, what);
  }
  const lines = commands.map(([title, line]) => commandLine(title, line));
  $("details").replaceChildren(...lines, list);
}

function hasDifference() {
  const [first, second] = [layerOf(view.first), layerOf(view.second)];
  const valued = first && second && first !== second && first.values && second.values;
  return Boolean(valued || (ofPair() && layerOf("difference")));
}

function modes() {
  const two = view.first !== view.second, able = {
    first: true, second: two, slider: two, flicker: two, difference: hasDifference(),
  };
  const wanted = view.mode;
  const mode = view.shown = able[wanted] ? wanted : "second";
  for (const button of document.querySelectorAll("[data-mode]")) {
    button.disabled = !able[button.dataset.mode] && !(button.dataset.mode === "second");
    button.setAttribute("aria-pressed", String(button.dataset.mode === mode && !view.wiggling));
  }
  const titles = ["first", "second"].map(name => (layerOf(view[name]) || { title: "" }).title);
  document.querySelector("[data-mode=first]").textContent = titles[0] || "A";
  document.querySelector("[data-mode=second]").textContent = titles[1] || "B";
  $("wiggle").disabled = !item().wiggle.length;
  $("wiggle").setAttribute("aria-pressed", String(view.wiggling));
  $("split").hidden = mode !== "slider";
  $("legend").hidden = mode !== "difference";
  $("full").textContent = shortly(fullNow() / 2 ** view.stops);
  $("stops").textContent = `${view.stops > 0 ? "+" : ""}${view.stops} EV`;
  badge(titles, mode);
  clearInterval(flickering);
  flickering = mode === "flicker" ? setInterval(() => { view.turn = !view.turn; badge(titles, mode); draw(); }, view.wiggling ? PERIOD / 2 : PERIOD) : 0;
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
  if (view.wiggling) {
    view.wiggling = view.chosen = false;
    view.mode = mode;
    show(view.item, true);
  }
  view.mode = mode;
  modes();
  tell(`${$("badge").textContent}`);
}

function wiggle() {
  if (!item().wiggle.length) return;
  view.wiggling = !view.wiggling;
  view.mode = view.wiggling ? "flicker" : "slider";
  view.chosen = false;
  if (!view.wiggling) view.first = "";
  show(view.item, true);
}

function expose(stops) {
  view.stops = Math.max(-20, Math.min(20, stops));
  $("exposure").value = view.stops;
  modes();
}

function step(by) {
  const place = view.order.indexOf(view.item);
  const next = view.order[place < 0 ? 0 : Math.max(0, Math.min(view.order.length - 1, place + by))];
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
      const layer = items[after(1)].layers.find(each => each.key === key);
      if (program && layer && layer.thumbnail) textureOf(layer.thumbnail, () => thumbTexture(layer.thumbnail));
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
  f: () => setMode(view.mode === "flicker" && !view.wiggling ? "slider" : "flicker"),
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

document.addEventListener("keydown", event => {
  const { target, key } = event;
  if (event.ctrlKey || event.metaKey || event.altKey || $("help").open) return;
  if (target.matches("input[type=search], select") || (target.matches("input[type=range]") && key.startsWith("Arrow"))) {
    if (key === "Escape") target.blur();
    return;
  }
  if (key === " " && target.matches("button, input, summary, a")) return;
  const act = item() && KEYS[key.length === 1 ? key.toLowerCase() : key];
  if (!act) return;
  event.preventDefault();
  act();
});

body.addEventListener("click", event => {
  const row = event.target.closest("tr");
  if (row) show(Number(row.dataset.item), true);
});
for (const button of document.querySelectorAll("[data-sort]")) button.onclick = () => sort(button.dataset.sort);
for (const button of document.querySelectorAll("[data-mode]")) button.onclick = () => setMode(button.dataset.mode);
$("filters").addEventListener("input", list_rows);
$("filters").addEventListener("submit", event => event.preventDefault());
$("help-button").onclick = KEYS["?"];
$("previous").onclick = () => step(-1);
$("next").onclick = () => step(1);
$("play").onclick = play;
$("wiggle").onclick = wiggle;
$("fit").onclick = fit;
$("in").onclick = () => zoomBy(1.5);
$("out").onclick = () => zoomBy(1 / 1.5);
$("worst").onclick = KEYS.g;
$("exposure").oninput = event => expose(Number(event.target.value));
$("split").oninput = event => { view.split = event.target.value / 1000; draw(); };
$("overlay").onchange = event => { view.overlay = event.target.value; draw(); };
for (const name of ["first", "second"]) $(name).onchange = event => {
  [view[name], view.wiggling, view.chosen] = [event.target.value, false, true];
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
    view.split = Math.max(0, Math.min(1, x / canvas.clientWidth));
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

start();
const gradient = heats.map(color => `rgb(${color.map(each => 255 * each).join(" ")})`);
$("legend").querySelector("i").style.background = `linear-gradient(90deg, ${gradient})`;
for (const image of document.querySelectorAll("img[data-payload]")) watcher.observe(image);
list_rows();
})();
