"use strict";

const data = JSON.parse(document.getElementById("data").textContent);
const { report, width, height, scale } = data;
const element = (id) => document.getElementById(id);

// ---- tables

const digits = (x) => (x === null || !Number.isFinite(x) ? "–" : x === 0 ? "0" : Math.abs(x) >= 0.01 && Math.abs(x) < 1e4 ? String(Number(x.toPrecision(3))) : x.toExponential(1));
const percent = (x) => `${digits(100 * x)} %`;

/** A table cell with a value above small print. */
function noted(value, note) {
  const cell = document.createElement("td");
  const small = document.createElement("small");
  small.textContent = note;
  cell.append(value, small);
  return cell;
}

/** A table cell with an estimate above its interval. */
function interval(value, format = digits) {
  return value === null ? noted("–", "") : noted(format(value.value), `${format(value.low)} to ${format(value.high)}`);
}

const isText = (value) => String(value).includes(" ") && !/^[\d.]/.test(value);

function fill(id, names, rows) {
  const table = element(id);
  const line = (cells, tag, parent) => {
    const row = parent.insertRow();
    for (const value of cells) {
      let cell = value;
      if (!(value instanceof Node)) {
        cell = document.createElement(tag);
        cell.textContent = value;
        cell.className = tag === "td" && isText(value) ? "text" : "";
      }
      row.append(cell);
    }
  };
  const head = table.createTHead();
  line(names, "th", head);
  // Headings are aligned like the text of their column.
  [...head.rows[0].cells].forEach((cell, i) => cell.classList.toggle("text", rows.some((cells) => !(cells[i] instanceof Node) && isText(cells[i]))));
  const body = table.createTBody();
  rows.forEach((cells) => line(cells, "td", body));
}

const { reference, device } = report;
const short = reference.goal !== null && reference.standard_error > reference.goal;
const error =
  reference.standard_error === null
    ? "of unknown error"
    : `with a standard error of ${percent(reference.standard_error)}${short ? ` (time ran out before it reached ${percent(reference.goal)})` : ""}`;
element("subject").textContent = `${report.scene}, ${width} × ${height} pixels, on ${device.name}; reference ${error}. Penumbra ${report.version}. Means over ${report.runs} runs of each entrant, with their 95 % intervals in small print.`;
element("advice").textContent = report.advice;

/** Cells that are left out of tables where no entrant has a denoiser. */
const anyDenoised = report.entrants.some((entrant) => entrant.denoisers.length > 0);
const denoising = (...cells) => (anyDenoised ? cells : []);

fill(
  "entrants",
  ["entrant", "finding", "time", ...denoising("denoiser"), "spp", "relMSE", ...denoising("estimate over relMSE"), "FLIP", "slope", "brightness", "set-up", "compilation", "warm-up"],
  report.entrants.map((entrant) => {
    const last = entrant.snapshots.at(-1);
    return [
      entrant.entrant,
      entrant.finding.text,
      `${digits(last.time.value)} s`,
      ...denoising(entrant.denoisers.length > 0 ? noted(`${digits(entrant.time.denoise)} s`, entrant.denoisers.join(", ")) : "–"),
      digits(last.samples.value),
      interval(last.relmse),
      ...denoising(interval(last.estimate_ratio)),
      interval(last.flip),
      interval(entrant.slope),
      interval(entrant.brightness, percent),
      `${digits(entrant.time.setup)} s`,
      `${digits(entrant.time.compile)} s`,
      `${digits(entrant.time.warm_up)} s`,
    ];
  }),
);
element("against").hidden = report.comparisons.length === 0;
fill(
  "comparisons",
  ["entrant", "at time", "error ratio", "at relMSE", "time ratio"],
  report.comparisons.map((row) => [row.entrant, `${digits(row.time)} s`, interval(row.error_ratio), digits(row.relmse), interval(row.time_ratio)]),
);
element("choice").hidden = report.auto.length === 0;
fill(
  "auto",
  ["entrant", "budget", "technique", "relMSE", "best", "relMSE of the best", "ratio"],
  report.auto.map((row) => [row.entrant, `${row.budget} s`, row.techniques.join(" or "), interval(row.relmse), row.best, interval(row.best_relmse), interval(row.ratio)]),
);
fill(
  "snapshots",
  ["entrant", "budget", "technique", "time", "spp", "relMSE", ...denoising("estimate", "estimate over relMSE"), "bias", "variance", "at boundaries", "elsewhere", "RMSE", "MAE", "p99", "shadow rays", "all rays"],
  report.entrants.flatMap((entrant) =>
    entrant.snapshots.map((s) => [
      entrant.entrant,
      `${s.budget} s`,
      s.techniques.join(" or "),
      interval(s.time),
      digits(s.samples.value),
      ...[s.relmse, ...denoising(s.estimate, s.estimate_ratio), s.bias, s.variance, s.relmse_boundary, s.relmse_elsewhere, s.rmse, s.mae, s.p99].map((x) => interval(x)),
      s.rays.shadow.toLocaleString("en"),
      s.rays.total.toLocaleString("en"),
    ]),
  ),
);
element("classification").hidden = report.classes.length === 0;
fill(
  "confusion",
  ["technique", "class", "hidden", "penumbra", "visible", "fill", "miss", "miss bias"],
  report.classes.flatMap((classes) =>
    ["lit", "shadowed", "boundary", "unknown"].map((name, i) => {
      const { hidden, penumbra, visible } = classes[name];
      const whole = i ? ["", "", ""] : [interval(classes.fill, percent), interval(classes.miss, percent), interval(classes.miss_bias)];
      return [i ? "" : classes.technique, name, hidden, penumbra, visible, ...whole];
    }),
  ),
);

element("swept").hidden = report.sweeps.length === 0;
fill(
  "sweeps",
  ["setting", "value", "boundary share", "fill", "miss"],
  report.sweeps.flatMap(({ setting, points }) =>
    points.map((p) => [setting, p.value, percent(p.boundary_share), interval(p.fill, percent), interval(p.miss, percent)]),
  ),
);
fill(
  "savings",
  ["setting", "value", "decided by", "relMSE", "shadow rays", "reduction", "all rays over two-pass", "time over two-pass", "fill seen", "miss bias"],
  report.sweeps.flatMap(({ setting, points }) =>
    points.flatMap((p) =>
      [["photons alone", p.photons_alone], ["with fine cells", p.fine_cells]].map(([name, s]) => [
        setting, p.value, name, digits(s.relmse), s.shadow_rays.toLocaleString("en"), percent(s.reduction), digits(s.rays), digits(s.time), percent(s.fill_seen), interval(s.miss_bias),
      ]),
    ),
  ),
);

// ---- images

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

/** Radiance of each possible half-precision float, computed once. */
const halves = Float32Array.from({ length: 65536 }, (_, h) => {
  const exponent = (h >> 10) & 31;
  const fraction = h & 1023;
  const size = exponent === 31 ? (fraction ? NaN : Infinity) : exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : 2 ** -14 * (fraction / 1024);
  return (h & 32768 ? -size : size) * scale;
});
const decode = (text) => Float32Array.from(new Uint16Array(bytes(text).buffer), (word) => halves[word]);
const decoded = new Map();
function radiance(index) {
  if (!decoded.has(index)) decoded.set(index, decode(data.views[index].pixels));
  return decoded.get(index);
}

const classMap = data.classes && bytes(data.classes);
const CLASSES = [
  ["dark", null],
  ["lit", [230, 159, 0]],
  ["shadowed", [0, 90, 200]],
  ["boundary", [213, 40, 0]],
  ["unknown", [204, 121, 167]],
];
const pixels = width * height;
const srgb = (x) => (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);
// Finer steps than a display's 8 bits.
const CODES = Uint8ClampedArray.from({ length: 4097 }, (_, i) => Math.round(255 * srgb(i / 4096)));
const code = (x) => CODES[x > 0 ? Math.min(4096, Math.round(4096 * x)) : 0];

/** Colours for 0 to 1, in order of brightness: black, blue, green, yellow, white. */
const HEAT = [[0, 0, 0], [40, 40, 190], [0, 160, 120], [240, 220, 40], [255, 255, 255]];
function heat(x) {
  const at = Math.min(0.9999, Math.max(0, x)) * (HEAT.length - 1);
  const i = Math.floor(at);
  return HEAT[i].map((low, c) => low + (at - i) * (HEAT[i + 1][c] - low));
}

/** The root of the mean over R, G and B of what relMSE is the mean of, for the error of each channel at a pixel of r. */
function relativeTo(r, pixel, error) {
  let sum = 0;
  for (let at = pixel; at < 3 * pixels; at += pixels) sum += error(at) ** 2 / (r[at] ** 2 + 0.01) / 3;
  return Math.sqrt(sum);
}

/** Relative difference of a pixel from that of another view, the reference unless it is given. */
function relative(index, pixel, other = 0) {
  const [x, r] = [radiance(index), radiance(other)];
  return relativeTo(r, pixel, (at) => x[at] - r[at]);
}

/** An error as a colour: at gain 1, 1 % or less is black and 100 % or more is white. */
const heatOf = (error, gain) => heat(1 + Math.log10(Math.max(1e-9, gain * error)) / 2);
const displayed = (index, pixel, gain) => [0, 1, 2].map((c) => code(gain * radiance(index)[c * pixels + pixel]));

/** A canvas with the colour of each pixel. */
function paintBy(colour) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [width, height];
  const context = canvas.getContext("2d");
  const image = context.createImageData(width, height);
  for (let pixel = 0; pixel < pixels; pixel++) image.data.set([...colour(pixel), 255], 4 * pixel);
  context.putImageData(image, 0, 0);
  return canvas;
}

/** Draws a view with the current exposure, mode and class overlay. */
function paint(index) {
  const gain = 2 ** Number(element("exposure").value);
  const asError = element("mode").value === "error";
  const overlay = element("classes").checked && classMap;
  return paintBy((pixel) => {
    const colour = asError ? heatOf(relative(index, pixel), gain) : displayed(index, pixel, gain);
    const tint = overlay && CLASSES[classMap[pixel]][1];
    return tint ? colour.map((value, c) => 0.65 * value + 0.35 * tint[c]) : colour;
  });
}

// ---- denoised images

element("denoising").hidden = data.denoised.length === 0;
for (const { denoised, raw, error } of data.denoised) {
  const expected = error && decode(error);
  const pictures = [
    ["raw", (pixel) => displayed(raw, pixel, 1)],
    ["denoised", (pixel) => displayed(denoised, pixel, 1)],
    ["difference", (pixel) => heatOf(relative(raw, pixel, denoised), 1)],
    ["estimated error", expected && ((pixel) => heatOf(relativeTo(radiance(denoised), pixel, () => expected[pixel]), 1))],
    ["error", (pixel) => heatOf(relative(denoised, pixel), 1)],
  ];
  const row = document.createElement("div");
  row.className = "row";
  for (const [name, colour] of pictures.filter(([, colour]) => colour)) {
    const figure = document.createElement("figure");
    const caption = document.createElement("figcaption");
    caption.textContent = name;
    const picture = paintBy(colour);
    picture.setAttribute("role", "img");
    picture.setAttribute("aria-label", `${data.views[denoised].name}: ${name}`);
    figure.append(picture, caption);
    row.append(figure);
  }
  const heading = document.createElement("h3");
  heading.textContent = data.views[denoised].name;
  element("denoised").append(heading, row);
}

// ---- viewer

const viewer = element("viewer");
const view = { zoom: 1, x: 0, y: 0, cursor: null };
let painted = [];
const ratio = () => window.devicePixelRatio || 1;
const selected = () => [Number(element("left").value), Number(element("right").value)];
const wiper = () => Number(element("wiper").value);

/** The panes of the canvas, in its pixels: one for both images, or one for each, side by side or one above the other. */
function panes() {
  const [w, h] = [viewer.width, viewer.height];
  if (element("layout").value === "wiper") return [[0, 0, w, h]];
  return w >= h ? [[0, 0, w / 2, h], [w / 2, 0, w / 2, h]] : [[0, 0, w, h / 2], [0, h / 2, w, h / 2]];
}

function repaint() {
  const [left, right] = selected();
  painted = left === right ? Array(2).fill(paint(left)) : [paint(left), paint(right)];
  const stops = Number(element("exposure").value);
  element("stops").textContent = `${stops > 0 ? "+" : ""}${stops} EV`;
  element("tints").hidden = !element("classes").checked;
  element("scale").hidden = element("mode").value !== "error";
  [element("min").textContent, element("max").textContent] = [0.01, 1].map((error) => percent(error / 2 ** stops));
  draw();
}

function draw() {
  const context = viewer.getContext("2d");
  context.clearRect(0, 0, viewer.width, viewer.height);
  context.imageSmoothingEnabled = false;
  const wiping = element("layout").value === "wiper";
  const parts = panes();
  painted.forEach((image, side) => {
    const [x, y, w, h] = parts[wiping ? 0 : side];
    const line = wiping ? wiper() * w : 0;
    context.save();
    context.beginPath();
    context.rect(wiping && side ? x + line : x, y, wiping ? (side ? w - line : line) : w, h);
    context.clip();
    context.drawImage(image, x + view.x, y + view.y, width * view.zoom, height * view.zoom);
    if (view.cursor) {
      context.strokeStyle = "#fff";
      context.strokeRect(x + view.x + view.cursor[0] * view.zoom, y + view.y + view.cursor[1] * view.zoom, view.zoom, view.zoom);
    }
    context.restore();
  });
  context.fillStyle = "#fff";
  if (wiping) context.fillRect(wiper() * viewer.width - ratio(), 0, 2 * ratio(), viewer.height);
  else context.fillRect(...(parts[1][0] ? [parts[1][0] - ratio(), 0, 2 * ratio(), viewer.height] : [0, parts[1][1] - ratio(), viewer.width, 2 * ratio()]));
}

function fit() {
  const [, , w, h] = panes()[0];
  view.zoom = Math.min(w / width, h / height);
  view.x = (w - width * view.zoom) / 2;
  view.y = (h - height * view.zoom) / 2;
  draw();
}

function zoom(factor, [x, y]) {
  const next = Math.min(64, Math.max(0.05, view.zoom * factor));
  view.x = x - ((x - view.x) * next) / view.zoom;
  view.y = y - ((y - view.y) * next) / view.zoom;
  view.zoom = next;
  draw();
}

function pan(x, y) {
  view.x += x;
  view.y += y;
  draw();
}

/** A pointer's position on the canvas and within its pane. */
function pointerPosition(event) {
  const box = viewer.getBoundingClientRect();
  const at = [(event.clientX - box.left) * ratio(), (event.clientY - box.top) * ratio()];
  const pane = panes().findLast(([x, y]) => at[0] >= x && at[1] >= y) ?? [0, 0];
  return { at, within: [at[0] - pane[0], at[1] - pane[1]] };
}

function point(cursor) {
  const inside = cursor[0] >= 0 && cursor[1] >= 0 && cursor[0] < width && cursor[1] < height;
  view.cursor = inside ? cursor : null;
  draw();
  if (!inside) {
    element("readout").textContent = "";
    return;
  }
  const pixel = cursor[1] * width + cursor[0];
  const value = (index) => [0, 1, 2].map((c) => digits(radiance(index)[c * pixels + pixel])).join(" ");
  const [left, right] = selected();
  const shown = [...new Set([left, right, 0])];
  const lines = shown.map((index) => `${data.views[index].name}: ${value(index)}${index ? `, relative error ${percent(relative(index, pixel))}` : ""}`);
  const name = classMap ? `, ${CLASSES[classMap[pixel]][0]}` : "";
  element("readout").textContent = [`pixel ${cursor[0]}, ${cursor[1]}${name}`, ...lines].join("\n");
}

const setWiper = (share) => {
  element("wiper").value = Math.min(1, Math.max(0, share));
  draw();
};

let drag = null;
viewer.addEventListener("pointerdown", (event) => {
  const { at } = pointerPosition(event);
  const wiping = element("layout").value === "wiper" && Math.abs(at[0] - wiper() * viewer.width) < 12 * ratio();
  drag = { wiping, x: event.clientX, y: event.clientY };
  viewer.setPointerCapture(event.pointerId);
});
viewer.addEventListener("pointermove", (event) => {
  const { at, within } = pointerPosition(event);
  if (drag?.wiping) setWiper(at[0] / viewer.width);
  else if (drag) {
    pan((event.clientX - drag.x) * ratio(), (event.clientY - drag.y) * ratio());
    [drag.x, drag.y] = [event.clientX, event.clientY];
  }
  point([Math.floor((within[0] - view.x) / view.zoom), Math.floor((within[1] - view.y) / view.zoom)]);
});
for (const type of ["pointerup", "pointercancel"]) viewer.addEventListener(type, () => (drag = null));
viewer.addEventListener(
  "wheel",
  (event) => {
    event.preventDefault();
    zoom(2 ** (-event.deltaY / 300), pointerPosition(event).within);
  },
  { passive: false },
);
viewer.addEventListener("keydown", (event) => {
  const [, , w, h] = panes()[0];
  const middle = [w / 2, h / 2];
  const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  const exposure = (stops) => {
    element("exposure").value = Number(element("exposure").value) + stops;
    repaint();
  };
  const actions = {
    "+": () => zoom(1.25, middle),
    "=": () => zoom(1.25, middle),
    "-": () => zoom(0.8, middle),
    0: fit,
    "[": () => setWiper(wiper() - 0.05),
    "]": () => setWiper(wiper() + 0.05),
    ",": () => exposure(-0.5),
    ".": () => exposure(0.5),
  };
  if (arrow && event.shiftKey) {
    const from = view.cursor ?? [width >> 1, height >> 1];
    point([Math.min(width - 1, Math.max(0, from[0] + arrow[0])), Math.min(height - 1, Math.max(0, from[1] + arrow[1]))]);
  } else if (arrow) pan(-40 * arrow[0] * ratio(), -40 * arrow[1] * ratio());
  else if (actions[event.key] && !event.ctrlKey && !event.metaKey) actions[event.key]();
  else return;
  event.preventDefault();
});

for (const id of ["left", "right"]) data.views.forEach((item, index) => element(id).add(new Option(item.name, index)));
element("left").value = data.views.length - 1;
element("right").value = 0;
element("classes").disabled = !classMap;
for (const id of ["left", "right", "mode", "classes", "exposure"]) element(id).addEventListener("input", repaint);
element("wiper").addEventListener("input", draw);
element("layout").addEventListener("input", fit);
element("fit").addEventListener("click", fit);
element("controls").addEventListener("submit", (event) => event.preventDefault());
if (classMap) {
  element("tints").append("Classes:");
  for (const [name, tint] of CLASSES.filter(([, tint]) => tint)) {
    const swatch = document.createElement("span");
    swatch.className = "swatch";
    swatch.style.background = `rgb(${tint})`;
    element("tints").append(swatch, name);
  }
}
for (const ramp of document.querySelectorAll(".ramp")) ramp.style.background = `linear-gradient(to right, ${HEAT.map((colour) => `rgb(${colour})`)})`;
function resize() {
  viewer.width = viewer.clientWidth * ratio();
  viewer.height = viewer.clientHeight * ratio();
  fit();
}
repaint();
// The observer's first call comes with a frame, which may be late on a busy machine.
resize();
new ResizeObserver(resize).observe(viewer);
