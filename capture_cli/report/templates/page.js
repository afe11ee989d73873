"use strict";

const { plots, curves } = JSON.parse(document.getElementById("data").textContent);
const config = {
  displaylogo: false,
  displayModeBar: "hover",
  modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
  responsive: true,
  showSendToCloud: false,
};
const places = [...document.querySelectorAll(".plot")];
const sets = {};
let view = 0;

// ---- colours: "--ink" in a plot is the CSS variable of that name ----

function painted(value, style) {
  if (typeof value === "string") return (value.startsWith("--") && style.getPropertyValue(value).trim()) || value;
  if (Array.isArray(value)) return value.map((v) => painted(v, style));
  if (value !== null && typeof value === "object" && !ArrayBuffer.isView(value)) {
    return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, painted(v, style)]));
  }
  return value;
}

const axis = { gridcolor: "--grid", linecolor: "--rule", zerolinecolor: "--rule", automargin: true };

function laidOut(layout) {
  const full = {
    margin: { l: 58, r: 12, t: 48, b: 44 }, // above the plot: buttons, then the legend
    hovermode: "x unified",
    legend: { orientation: "h", x: 0, y: 1, xanchor: "left", yanchor: "bottom" },
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    hoverlabel: { bgcolor: "--raised", bordercolor: "--rule", font: { color: "--ink" } },
    modebar: { bgcolor: "rgba(0,0,0,0)", color: "--muted", activecolor: "--ink" },
    ...layout,
    font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: "--muted", ...layout.font },
  };
  for (const key of Object.keys(full)) {
    if (!/^[xy]axis/.test(key)) continue;
    full[key] = { ...axis, ...full[key] };
    // without it a title keeps its place, and long numbers run into it
    if (key[0] === "y" && full[key].title) full[key].title = { standoff: 8, ...full[key].title };
  }
  return full;
}

// ---- curves: traces that take their points from the view chosen ----

function unpacked({ dtype, bdata }) {
  const bytes = Uint8Array.from(atob(bdata), (c) => c.charCodeAt(0));
  return dtype === "f4" ? new Float32Array(bytes.buffer) : new Float64Array(bytes.buffer);
}

function points(series) {
  const { set, first, last } = curves.views[view];
  sets[set] ??= Object.fromEntries(Object.entries(curves.sets[set]).map(([name, p]) => [name, unpacked(p)]));
  return sets[set][series].subarray(first, last);
}

function extent(arrays) {
  let low = Infinity;
  let high = -Infinity;
  for (const values of arrays) {
    for (const v of values) {
      if (v < low) low = v;
      if (v > high) high = v;
    }
  }
  const margin = 0.07 * (high - low) || 1e-3 * Math.abs(high) || 1;
  return [low - margin, high + margin];
}

// The axis follows the traces that say so ("meta": {"frame": true}): a nominal that runs away must not hide the rest.
function fromCurves(figure) {
  if (!figure.data.some((trace) => trace.meta?.series)) return figure;
  const data = figure.data.map((trace) =>
    trace.meta?.series ? { ...trace, x: points("x"), y: points(trace.meta.series) } : trace
  );
  const layout = { ...figure.layout };
  const framed = {};
  for (const trace of data) {
    if (trace.meta?.frame) (framed[`yaxis${(trace.yaxis ?? "y").slice(1)}`] ??= []).push(trace.y);
  }
  for (const [name, arrays] of Object.entries(framed)) layout[name] = { ...layout[name], range: extent(arrays) };
  const x = points("x");
  layout.xaxis = { ...layout.xaxis, range: [x[0], x[x.length - 1]] };
  layout.uirevision = view;
  return { data, layout };
}

// ---- drawing ----

function draw(place) {
  const figure = plots[place.id];
  if (!figure || place.offsetParent === null) return; // folded away: drawn when it opens
  const { data, layout } = fromCurves(figure);
  const style = getComputedStyle(document.documentElement);
  Plotly.react(place, painted(data, style), painted(laidOut(layout), style), { ...config, ...figure.config });
}

function drawAll() {
  places.forEach(draw);
}

function choose(number) {
  view = number;
  document.getElementById("view").selectedIndex = view;
  document.getElementById("view-before").disabled = view === 0;
  document.getElementById("view-after").disabled = view === curves.views.length - 1;
  places.filter((place) => plots[place.id]?.data.some((trace) => trace.meta?.series)).forEach(draw);
}

const selector = document.getElementById("view");
if (selector) {
  for (const { label } of curves.views) selector.add(new Option(label));
  selector.addEventListener("change", () => choose(selector.selectedIndex));
  document.getElementById("view-before").addEventListener("click", () => choose(view - 1));
  document.getElementById("view-after").addEventListener("click", () => choose(view + 1));
  choose(0);
}
for (const fold of document.querySelectorAll("details")) {
  fold.addEventListener("toggle", () => fold.querySelectorAll(".plot").forEach(draw));
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);

// ---- long tables: sorted by a click on the head, filtered by typing ----

function sortBy(table, head) {
  const isNumeric = head.classList.contains("num");
  const orders = isNumeric ? ["descending", "ascending"] : ["ascending", "descending"];
  const order = orders[head.getAttribute("aria-sort") === orders[0] ? 1 : 0];
  for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", order);
  const key = (row) => row.cells[head.cellIndex].dataset.key;
  const compared = (a, b) => {
    if (key(a) === "" || key(b) === "") return (key(a) === "") - (key(b) === ""); // what is missing comes last
    return (order === "ascending" ? 1 : -1) * (isNumeric ? key(a) - key(b) : key(a).localeCompare(key(b)));
  };
  table.tBodies[0].append(...[...table.tBodies[0].rows].sort(compared));
}

for (const browser of document.querySelectorAll(".browser")) {
  const table = browser.querySelector("table");
  for (const head of table.tHead.rows[0].cells) head.addEventListener("click", () => sortBy(table, head));
  const input = browser.querySelector("input");
  input.addEventListener("input", () => {
    const wanted = input.value.toLowerCase().split(/\s+/);
    for (const row of table.tBodies[0].rows) {
      const text = row.textContent.toLowerCase();
      row.hidden = !wanted.every((word) => text.includes(word));
    }
  });
}

// ---- paper: light colours, everything unfolded, plots as wide as the sheet ----

let folded = [];

function toPaper() {
  document.documentElement.dataset.theme = "light";
  folded = [...document.querySelectorAll("details:not([open])")];
  folded.forEach((fold) => (fold.open = true));
  document.querySelectorAll(".browser tr[hidden]").forEach((row) => (row.hidden = false));
  document.querySelector("main").style.width = "680px";
  drawAll();
  places.forEach((place) => place.data && Plotly.relayout(place, { width: place.clientWidth }));
}

function toScreen() {
  delete document.documentElement.dataset.theme;
  folded.forEach((fold) => (fold.open = false));
  document.querySelector("main").style.width = "";
  places.forEach((place) => place.data && Plotly.relayout(place, { width: null, autosize: true }));
  drawAll();
}

addEventListener("beforeprint", toPaper);
addEventListener("afterprint", toScreen);
drawAll();
