// Drawings on canvases: maps from above, and the camera's picture. Metres, north at the top.

const TAU = 2 * Math.PI;
const CAR_LENGTH_M = 2, CAR_WIDTH_M = 1.1;

export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

function channels(name) {
  const hex = colour(name).slice(1);
  return [0, 2, 4].map((at) => parseInt(hex.slice(at, at + 2), 16));
}

export function bits(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return (index) => (bytes[index >> 3] >> (7 - (index & 7))) & 1;
}

// A canvas whose unit is the metre, with the origin in the middle and y to the north.
export class Plan {
  constructor(canvas, arena) {
    this.context = canvas.getContext("2d");
    this.size = canvas.width;
    this.arena = arena;
    this.scale = canvas.width / arena;
  }

  place([x, y]) {
    return [(x + this.arena / 2) * this.scale, (this.arena / 2 - y) * this.scale];
  }

  clear(fill) {
    this.context.setLineDash([]);
    this.context.globalAlpha = 1;
    this.context.fillStyle = fill;
    this.context.fillRect(0, 0, this.size, this.size);
  }

  trace(points, closed = false) {
    this.context.beginPath();
    points.forEach((point, index) => this.context[index ? "lineTo" : "moveTo"](...this.place(point)));
    if (closed) this.context.closePath();
  }

  line(points, stroke, width = 1, { closed = false, dash = [] } = {}) {
    if (points.length < 2) return;
    this.trace(points, closed);
    this.context.strokeStyle = stroke;
    this.context.lineWidth = width;
    this.context.lineJoin = "round";
    this.context.setLineDash(dash);
    this.context.stroke();
    this.context.setLineDash([]);
  }

  fill(points, fill, alpha = 1) {
    this.trace(points, true);
    this.context.globalAlpha = alpha;
    this.context.fillStyle = fill;
    this.context.fill();
    this.context.globalAlpha = 1;
  }

  circle(centre, radius, { fill, stroke, width = 1 }) {
    this.context.beginPath();
    this.context.arc(...this.place(centre), Math.max(1, radius * this.scale), 0, TAU);
    if (fill) { this.context.fillStyle = fill; this.context.fill(); }
    if (stroke) { this.context.strokeStyle = stroke; this.context.lineWidth = width; this.context.stroke(); }
  }

  text(at, words, fill) {
    this.context.font = `600 ${Math.round(this.size / 36)}px system-ui, sans-serif`;
    this.context.textAlign = "center";
    this.context.lineWidth = 3;
    this.context.strokeStyle = colour("free");
    this.context.strokeText(words, ...this.place(at));
    this.context.fillStyle = fill;
    this.context.fillText(words, ...this.place(at));
  }

  car([x, y, degrees]) {
    const heading = degrees * Math.PI / 180, [c, s] = [Math.cos(heading), Math.sin(heading)];
    const at = (ahead, left) => [x + c * ahead - s * left, y + s * ahead + c * left];
    const [l, w] = [Math.max(CAR_LENGTH_M, 14 / this.scale) / 2, Math.max(CAR_WIDTH_M, 8 / this.scale) / 2];
    this.fill([at(-l, w), at(0.4 * l, w), at(l, 0), at(0.4 * l, -w), at(-l, -w)], colour("car"));
    this.line([at(-l, w), at(0.4 * l, w), at(l, 0), at(0.4 * l, -w), at(-l, -w)], colour("free"), 1, { closed: true });
  }

  star([x, y], radius) {
    const tips = Array.from({ length: 10 }, (_, index) => {
      const angle = TAU / 4 + index * TAU / 10, r = index % 2 ? 0.42 * radius : radius;
      return [x + r * Math.cos(angle), y + r * Math.sin(angle)];
    });
    this.fill(tips, colour("goal"));
    this.line(tips, colour("free"), 1, { closed: true });
  }

  obstacles(view, stroke, fill) {
    for (const [x, y, radius] of view.circles ?? []) this.circle([x, y], radius, { stroke, fill });
    for (const [x, y, length, width, degrees] of view.boxes ?? []) {
      const a = degrees * Math.PI / 180, [c, s] = [Math.cos(a), Math.sin(a)];
      const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([i, j]) => [x + (c * i * length - s * j * width) / 2, y + (s * i * length + c * j * width) / 2]);
      if (fill) this.fill(corners, fill);
      if (stroke) this.line(corners, stroke, 1, { closed: true });
    }
  }
}

function drawBelief(plan, belief) {
  const size = belief.size, image = new ImageData(size, size);
  const [seen, occupied] = [bits(belief.seen), bits(belief.occupied)];
  const shades = [channels("unseen"), channels("free"), channels("occupied")];
  for (let row = 0; row < size; row++) for (let column = 0; column < size; column++) {
    const index = row * size + column, shade = shades[occupied(index) ? 2 : seen(index) ? 1 : 0];
    image.data.set([...shade, 255], 4 * ((size - 1 - row) * size + column));
  }
  const small = new OffscreenCanvas(size, size);
  small.getContext("2d").putImageData(image, 0, 0);
  plan.context.imageSmoothingEnabled = false;
  plan.context.drawImage(small, 0, 0, plan.size, plan.size);
}

function blockCorners(view, [bx, by]) {
  const side = view.grid_m / view.blocks, [west, south] = [bx * side - view.grid_m / 2, by * side - view.grid_m / 2];
  return [[west, south], [west + side, south], [west + side, south + side], [west, south + side]];
}

function drawValues(plan, view) {
  const near = view.choices.filter((choice) => !choice.goal), values = near.map((choice) => choice.value);
  const [low, high] = [Math.min(...values), Math.max(...values)];
  for (const choice of near) {
    const share = high > low ? (choice.value - low) / (high - low) : 0.5, corners = blockCorners(view, choice.block);
    plan.fill(corners, colour("value"), 0.1 + 0.4 * share);
    plan.text([(corners[0][0] + corners[1][0]) / 2, corners[2][1] - view.grid_m / view.blocks * 0.16], choice.value.toFixed(2), colour("text"));
  }
  const half = view.grid_m / 2;
  for (let index = 0; index <= view.blocks; index++) {
    const at = index * view.grid_m / view.blocks - half;
    plan.line([[at, -half], [at, half]], colour("grid"), 1);
    plan.line([[-half, at], [half, at]], colour("grid"), 1);
  }
}

function drawGradients(plan, view) {
  const side = view.grid_m / view.blocks;
  for (const { block, to: [east, north] } of view.gradients) {
    const [[west, south]] = blockCorners(view, block), [x, y, half] = [west + side / 2, south + side / 2, side * 0.26];
    const tip = [x + east * half, y + north * half], back = [x - east * half, y - north * half];
    plan.line([back, tip], colour("arrow"), 2.5);
    const at = (ahead, left) => [tip[0] + east * ahead - north * left, tip[1] + north * ahead + east * left];
    plan.fill([at(0.35, 0), at(-0.35, 0.4), at(-0.35, -0.4)], colour("arrow"));
  }
}

function cameraPose(view) {
  const [x, y, degrees] = view.decided_at, heading = degrees * Math.PI / 180, ahead = view.camera.forward_m;
  return [x + ahead * Math.cos(heading), y + ahead * Math.sin(heading), heading];
}

function drawRays(plan, view) {
  const [x, y, heading] = cameraPose(view);
  const at = (index, metres) => {
    const angle = heading + view.rays.angles_deg[index] * Math.PI / 180;
    return [x + metres * Math.cos(angle), y + metres * Math.sin(angle)];
  };
  plan.fill([[x, y], ...view.rays.median_m.map((metres, index) => at(index, metres))], colour("ray"), 0.18);
  view.rays.near_m.forEach((metres, index) => plan.line([at(index, metres), at(index, view.rays.far_m[index])], colour("ray"), 1.5));
}

// Draws the map of a close look; `shown` is a set of layers.
export function drawMap(canvas, view, shown) {
  const plan = new Plan(canvas, view.arena_m);
  plan.clear(colour("unseen"));
  if (view.belief && shown.has("belief")) drawBelief(plan, view.belief);
  if (view.choices && shown.has("values")) drawValues(plan, view);
  if (shown.has("truth")) plan.obstacles(view, colour("truth"));
  if (view.rays && shown.has("rays")) drawRays(plan, view);
  if (view.gradients && shown.has("gradients")) drawGradients(plan, view);
  plan.line(view.path, colour("path"), 2.5);
  if (view.way && shown.has("way")) plan.line(view.way, colour("path"), 2, { dash: [5, 5] });
  plan.circle(view.start, 0.32, { fill: colour("start") });
  if (view.subgoal) plan.circle(view.subgoal, 0.5, { stroke: colour("subgoal"), width: 3 });
  plan.star(view.goal, 0.8);
  plan.car(view.pose);
}

// Draws a small map of a car with the path that this page has seen.
export function drawTile(canvas, car, path, arena) {
  const plan = new Plan(canvas, arena);
  plan.clear(colour("free"));
  plan.obstacles(car, null, colour("unseen"));
  plan.line([...path, car.pose], colour("path"), 1.5);
  plan.circle(car.start, 0.5, { fill: colour("start") });
  plan.star(car.goal, 1.5);
  plan.car(car.pose);
}

const HEAT = [[87, 16, 110], [188, 55, 84], [249, 142, 9], [252, 255, 164]]; // dark to bright

function heat(share) {
  const at = Math.min(share, 0.999) * (HEAT.length - 1), index = Math.floor(at);
  return HEAT[index].map((value, channel) => value + (at - index) * (HEAT[index + 1][channel] - value));
}

function drawAttention(context, size, { side, weights, seen }, direction) {
  const field = weights[direction], most = Math.max(...field), image = new ImageData(side, side);
  field.forEach((weight, index) => {
    const share = weight / most;
    image.data.set([...heat(share), 255 * 0.7 * seen[direction] * share ** 0.6], 4 * index);
  });
  const small = new OffscreenCanvas(side, side);
  small.getContext("2d").putImageData(image, 0, 0);
  context.imageSmoothingEnabled = true;
  context.imageSmoothingQuality = "high";
  context.drawImage(small, 0, 0, size, size);
}

// Draws the camera's picture with rays and the attention of a direction, or of none (null).
export function drawCamera(canvas, picture, view, shown, direction) {
  const context = canvas.getContext("2d"), size = canvas.width;
  context.imageSmoothingEnabled = true;
  context.drawImage(picture, 0, 0, size, size);
  if (view.attention && direction !== null) drawAttention(context, size, view.attention, direction);
  if (!shown.has("rays")) return;
  const focal = size / 2 / Math.tan(view.camera.field_of_view_deg * Math.PI / 360);
  const row = (index, metres) => {
    const depth = Math.max(0.05, metres * Math.cos(view.rays.angles_deg[index] * Math.PI / 180));
    return Math.min(size, size / 2 + focal * view.camera.height_m / depth);
  };
  view.rays.angles_deg.forEach((degrees, index) => {
    const column = size / 2 - focal * Math.tan(degrees * Math.PI / 180);
    for (const [stroke, width] of [["#000", 4], ["#fff", 2]]) {
      context.strokeStyle = stroke;
      context.lineWidth = width;
      context.beginPath();
      context.moveTo(column, row(index, view.rays.near_m[index]));
      context.lineTo(column, row(index, view.rays.far_m[index]));
      context.stroke();
    }
    context.beginPath();
    context.arc(column, row(index, view.rays.median_m[index]), 4, 0, TAU);
    context.fillStyle = view.rays.median_m[index] < 0.98 * view.camera.range_m ? "#ffb000" : "#4cc38a";
    context.fill();
    context.strokeStyle = "#000";
    context.lineWidth = 1;
    context.stroke();
  });
}
