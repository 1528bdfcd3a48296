// What pages share: payloads, news for screen readers, command lines to copy, keys.
"use strict";
const $ = id => document.getElementById(id);
const loaded = new Promise(done => {
  if (document.readyState !== "loading") done();
  else document.addEventListener("DOMContentLoaded", done);
});

// ---- payloads: base64 in elements at the end of the file

async function textOf(name) {
  if (!$(name) || !$(name).nextElementSibling) await loaded; // or a part of it may be there
  return $(name).textContent;
}

async function bytesOf(name) {
  const text = atob(await textOf(name)), bytes = new Uint8Array(text.length);
  for (let n = 0; n < text.length; n++) bytes[n] = text.charCodeAt(n);
  return bytes;
}

const addressOf = async name => {
  const text = await textOf(name);
  return `data:image/${text.startsWith("iVBOR") ? "png" : "jpeg"};base64,${text}`;
};

// The pixels of a picture: bytes of red, green, blue and alpha, with width and height.
async function pixelsOf(name) {
  const image = new Image(), canvas = document.createElement("canvas");
  image.src = await addressOf(name);
  await image.decode();
  [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0);
  return context.getImageData(0, 0, canvas.width, canvas.height);
}

const tell = words => { $("news").textContent = words; };

// A command line with its title, and a button that copies it.
function commandLine(title, line) {
  const box = document.createElement("div"), label = document.createElement("span");
  const code = document.createElement("code"), copy = document.createElement("button");
  box.className = "command";
  label.textContent = title;
  code.textContent = line;
  copy.type = "button";
  copy.textContent = "Copy";
  copy.setAttribute("aria-label", `Copy: ${title}`);
  copy.onclick = () => copied(code, copy);
  box.append(label, code, copy);
  return box;
}

async function copied(code, button) {
  try {
    await navigator.clipboard.writeText(code.textContent);
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = "Copy"; }, 1500);
  } catch {
    getSelection().selectAllChildren(code); // to be copied by hand
  }
}

// Keys act by a table, but where an element takes the key itself.
function listen(keys, takes) {
  document.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey || $("help").open || takes(event)) return;
    const act = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });
  $("help-button").onclick = keys["?"];
}
