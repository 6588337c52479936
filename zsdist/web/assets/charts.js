// Curves of several runs, as SVG. One slider, or the pointer, moves the cursor of all charts.
import { element, number, setText } from "./text.js";

const WIDTH = 360, HEIGHT = 170, LEFT = 46, RIGHT = 8, TOP = 8, BOTTOM = 22;
const DASHES = ["", "7 3", "2 3", "9 3 2 3", "", "7 3", "2 3", "9 3 2 3"];

function svg(name, attributes) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

export function line(index) {
  return { fill: "none", stroke: `var(--run-${index % 8})`, "stroke-width": 1.8, "stroke-dasharray": DASHES[index % 8], "stroke-linejoin": "round" };
}

export function swatch(index) {
  const made = svg("svg", { class: "swatch", viewBox: "0 0 22 8", "aria-hidden": "true" });
  made.append(svg("path", { d: "M0 4 H22", ...line(index), "stroke-width": 3 }));
  return made;
}

// Positions of a run's rows on the axis: episodes, steps, or minutes since the first row.
export function positions(curves, axis) {
  if (axis !== "minutes") return curves[axis] ?? [];
  const times = curves.time_s ?? [];
  const first = times.find((time) => time !== null);
  return times.map((time) => (time === null ? null : (time - first) / 60));
}

export function extent(lists) {
  let low = Infinity, high = -Infinity;
  for (const list of lists) for (const value of list) {
    if (value === null) continue;
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  return low > high ? [0, 1] : low === high ? [low - 0.5, high + 0.5] : [low, high];
}

function ticks(low, high) {
  const rough = (high - low) / 4, unit = 10 ** Math.floor(Math.log10(rough));
  const step = unit * [1, 2, 5, 10].find((factor) => factor * unit >= rough);
  const found = [];
  for (let at = Math.ceil(low / step) * step; at <= high + step * 1e-6; at += step) found.push(Math.abs(at) < step * 1e-6 ? 0 : at);
  return found;
}

function short(value) {
  const size = Math.abs(value);
  if (size >= 1e6) return `${+(value / 1e6).toPrecision(3)}M`;
  if (size >= 1e4) return `${+(value / 1e3).toPrecision(3)}k`;
  return String(+value.toPrecision(3));
}

export class Chart {
  constructor(title, onPoint) {
    this.svg = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": `Curve: ${title}` });
    this.values = element("ul");
    this.root = element("div", {}, element("h3", {}, title), this.svg, this.values);
    this.title = title;
    this.svg.addEventListener("pointermove", (event) => {
      const box = this.svg.getBoundingClientRect();
      const share = ((event.clientX - box.left) / box.width * WIDTH - LEFT) / (WIDTH - LEFT - RIGHT);
      onPoint(Math.min(1, Math.max(0, share)));
    });
  }

  // `runs` is a list of {name, index, x, y}; `xs` the extent of the axis.
  draw(runs, xs) {
    this.runs = runs;
    this.xs = xs;
    const ys = extent(runs.map((run) => run.y));
    const x = (value) => LEFT + (value - xs[0]) / (xs[1] - xs[0]) * (WIDTH - LEFT - RIGHT);
    const y = (value) => HEIGHT - BOTTOM - (value - ys[0]) / (ys[1] - ys[0]) * (HEIGHT - TOP - BOTTOM);
    this.toX = x;
    const parts = [];
    for (const at of ticks(...ys)) {
      parts.push(svg("path", { d: `M${LEFT} ${y(at)} H${WIDTH - RIGHT}`, stroke: "var(--line)", "stroke-width": 0.7 }));
      const text = svg("text", { x: LEFT - 4, y: y(at) + 4, "text-anchor": "end" });
      text.textContent = short(at);
      parts.push(text);
    }
    for (const at of ticks(...xs)) {
      const text = svg("text", { x: x(at), y: HEIGHT - 6, "text-anchor": x(at) > WIDTH - 24 ? "end" : "middle" });
      text.textContent = short(at);
      parts.push(text);
    }
    for (const run of runs) {
      let path = "", pen = "M";
      run.y.forEach((value, index) => {
        if (value === null || run.x[index] === null || run.x[index] === undefined) { pen = "M"; return; }
        path += `${pen}${x(run.x[index]).toFixed(1)} ${y(value).toFixed(1)}`;
        pen = "L";
      });
      if (path) parts.push(svg("path", { d: path, ...line(run.index) }));
    }
    this.mark = svg("path", { stroke: "var(--text)", "stroke-width": 0.8, "stroke-dasharray": "3 3" });
    this.svg.replaceChildren(...parts, this.mark);
    this.values.replaceChildren(...runs.map((run) => element("li", {}, swatch(run.index), element("span", {}, run.name), element("b"))));
  }

  // Shows the values at a share of the axis, from 0 to 1.
  point(share) {
    if (!this.runs) return;
    const at = this.xs[0] + share * (this.xs[1] - this.xs[0]);
    this.mark.setAttribute("d", `M${this.toX(at)} ${TOP} V${HEIGHT - BOTTOM}`);
    const said = this.runs.map((run, place) => {
      let found = null;
      run.x.forEach((value, index) => {
        if (value !== null && value <= at + 1e-9 && run.y[index] !== null) found = run.y[index];
      });
      setText(this.values.children[place].lastChild, number(found));
      return `${run.name} ${number(found)}`;
    });
    this.svg.setAttribute("aria-label", `Curve: ${this.title}. At ${short(at)}: ${said.join(", ")}`);
  }
}
