// The cars: one small map for each, and a close look at one of them.
import { colour, drawCamera, drawMap, drawTile } from "./draw.js";
import { element, number, setText, showPairs } from "./text.js";

const ARENA_M = 25, MOST_PATH = 600, TILE_PX = 96;
const DIRECTIONS = { forward: 0, left_45: 1, turn_left_90: 1, right_45: 2, turn_right_90: 2 };
const ACTIONS = { forward: "forward", left_45: "45° left", right_45: "45° right", turn_left_90: "turn 90° left", turn_right_90: "turn 90° right" };
const BEHAVIOURS = { greedy: "the network", guide: "the guide policy", uniform: "chance" };

const find = (id) => document.getElementById(id);
const tiles = new Map(); // by car, such as actor-0/2

export let chosen = "";

function task(car) {
  if (car.kind === "idle") return "idle";
  return car.kind === "training" ? `episode ${car.number}` : `${car.kind}, scene ${car.number}`;
}

function makeTile(name) {
  const input = element("input", { type: "radio", name: "car", value: name });
  const canvas = element("canvas", { width: TILE_PX, height: TILE_PX, "aria-hidden": "true" });
  const text = element("span");
  const label = element("label", {}, input, canvas, text);
  input.addEventListener("change", () => { chosen = name; });
  return { label, input, canvas, text, path: [], drive: "", last: "" };
}

// Reads the answer of an actor; one that cannot be read shows no car.
function read(answer) {
  try {
    const { actor, cars } = JSON.parse(answer);
    return { actor: String(actor), cars: Array.isArray(cars) ? cars : [] };
  } catch {
    return { actor: "", cars: [] };
  }
}

// Shows all cars of a state.
export function showCars(state) {
  const cars = new Map();
  for (const { actor, cars: own } of (state.actors ?? []).map(read)) for (const car of own) cars.set(`${actor}/${car.car}`, car);
  const names = [...cars.keys()].sort((a, b) => a.localeCompare(b, "en", { numeric: true }));
  const box = find("tiles");
  for (const [name, tile] of tiles) if (!cars.has(name)) {
    tile.label.remove();
    tiles.delete(name);
  }
  names.forEach((name, index) => {
    if (!tiles.has(name)) tiles.set(name, makeTile(name));
    const tile = tiles.get(name), car = cars.get(name);
    if (box.children[index + 1] !== tile.label) box.insertBefore(tile.label, box.children[index + 1] ?? null);
    showTile(tile, name, car);
  });
  if (chosen && !cars.has(chosen)) chosen = "";
  find("tiles").hidden = !names.length;
  find("detail").hidden = !chosen;
  document.querySelector(".split").classList.toggle("chosen", Boolean(chosen));
  setText(find("cars-told"), toldOfCars(state, cars));
}

function toldOfCars(state, cars) {
  if (!cars.size) return state.status === "live" ? "No car has answered yet. Actors of an older version do not show their cars." : "No car drives now.";
  const driving = [...cars.values()].filter((car) => car.kind !== "idle").length;
  return `${driving} of ${cars.size} cars drive.`;
}

function showTile(tile, name, car) {
  setText(tile.text, `${name.replace("actor-", "").replace("/", "·")} ${car.kind === "idle" ? "idle" : car.step}`);
  const label = `${name.replace("/", ", car ")}: ${task(car)}`;
  if (tile.label.title !== label) { tile.label.title = label; tile.input.setAttribute("aria-label", label); }
  const now = `${JSON.stringify(car.pose)}${car.number}${document.documentElement.dataset.colours}`;
  if (now === tile.last) return;
  tile.last = now;
  if (car.kind === "idle") {
    const context = tile.canvas.getContext("2d");
    context.fillStyle = colour("unseen");
    context.fillRect(0, 0, TILE_PX, TILE_PX);
    return;
  }
  const drive = `${car.kind} ${car.number}`;
  if (tile.drive !== drive || !tile.path.length) { tile.drive = drive; tile.path = car.step <= 2 ? [car.start] : []; }
  drawTile(tile.canvas, car, tile.path, ARENA_M);
  tile.path.push(car.pose);
  if (tile.path.length > MOST_PATH) tile.path.shift();
}

function layers() {
  return new Set([...find("layers").querySelectorAll("input:checked")].map((input) => input.value));
}

let picture = null, pictureOf = "", view = null;

// Shows the close look; without an argument draws the last one again.
export async function showView(newest = view) {
  view = newest;
  if (!chosen || !view || `${view.actor}/${view.car}` !== chosen) return;
  setText(find("car-title"), `${chosen.replace("/", ", car ")}: ${task(view)}`);
  if (view.kind === "idle") {
    setText(find("car-told"), "It waits for its next episode.");
    return;
  }
  const shown = layers();
  drawMap(find("map"), view, shown);
  const [x, y] = view.pose, away = Math.hypot(view.goal[0] - x, view.goal[1] - y);
  find("map").setAttribute("aria-label", `Map: the car is at ${x} m east, ${y} m north, ${away.toFixed(1)} m from the goal`);
  setText(find("car-told"), view.decided_at ? view.attention_told ? `No attention is shown: ${view.attention_told}.` : "" : "It has not decided anything yet.");
  if (view.picture) await showPicture(shown);
  showPairs(find("car-figures"), figures(away));
}

async function showPicture(shown) {
  const own = view;
  if (pictureOf !== own.picture) {
    const image = new Image();
    image.src = `data:image/jpeg;base64,${own.picture}`;
    await image.decode();
    picture = image;
    pictureOf = own.picture;
  }
  const asked = find("attention").value;
  const direction = asked === "none" ? null : asked === "action" ? DIRECTIONS[own.action] : Number(asked);
  drawCamera(find("camera"), picture, own, shown, direction);
  const metres = own.clearance_m.map((value) => value.toFixed(1));
  find("camera").setAttribute("aria-label", `Camera: free ahead ${metres[0]} m, to the left ${metres[1]} m, to the right ${metres[2]} m`);
}

function figures(away) {
  const pairs = [["scene", view.scene], ["action", view.step], ["to the goal", `${away.toFixed(1)} m`], ["exploration", number(view.epsilon)], ["shield", view.shielded ? "on" : "off"]];
  if (!view.action) return pairs;
  const goal = view.choices.find((choice) => choice.goal);
  return [
    ...pairs,
    ["last decision", `${ACTIONS[view.action]}, by ${BEHAVIOURS[view.behaviour]}${view.shield_changed ? ", changed by the shield" : ""}`],
    ["free ahead, left, right", view.clearance_m.map((value) => value.toFixed(1)).join(", ") + " m"],
    ["advice ahead, left, right", view.advice.map((value) => value.toFixed(1)).join(", ")],
    ["moves, ahead, left, right", view.dynamic.map((value) => `${(100 * value).toFixed(0)}%`).join(", ")],
    ["value of the goal as choice", goal ? number(goal.value) : "-"],
  ];
}

find("layers").addEventListener("change", () => showView());
