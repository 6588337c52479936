// Asks for what is shown, twice a second, and only while the page is visible.
import { chosen, showCars, showView } from "./cars.js";
import { Chart, extent, positions, swatch } from "./charts.js";
import { element, number, setText, showPairs, words } from "./text.js";

const LIVE_MS = 500, RUNS_MS = 5000, CURVES_MS = 10000, MOST_COMPARED = 8;
const find = (id) => document.getElementById(id);
const CURVES = { recent_success: "Success, last 50 episodes", mean_return: "Mean return of an episode", env_steps_per_s: "Steps a second", epsilon: "Exploration (epsilon)", high_loss: "Loss, high level", low_loss: "Loss, low level", high_q_mean: "Mean value, high level", low_q_mean: "Mean value, low level" };

let runs = [], follows = true, compared = null;
const own = new Map(); // figures of the live run that this page has seen, where there is no folder to read them from

async function ask(path) {
  const answer = await fetch(path, { cache: "no-store" });
  const content = await answer.json();
  if (!answer.ok) throw new Error(content.error ?? answer.statusText);
  return content;
}

// Repeats work while the page is visible; never twice at a time.
function repeat(work, everyMs) {
  let timer = 0, busy = false;
  const round = async () => {
    clearTimeout(timer);
    if (document.hidden || busy) return;
    busy = true;
    const before = performance.now();
    try { await work(); } catch (error) { say("bad", `✕ ${error instanceof TypeError ? "the monitor does not answer; is it still running?" : error.message}`); }
    busy = false;
    timer = setTimeout(round, Math.max(50, everyMs - (performance.now() - before)));
  };
  document.addEventListener("visibilitychange", round);
  round();
  return round;
}

function say(kind, text) {
  find("status").className = kind;
  setText(find("status"), text);
}

function run() { return find("run").value; }

// ---- which runs there are

async function refreshRuns() {
  const listed = await ask("runs.json");
  const before = JSON.stringify(runs);
  runs = listed.runs;
  if (JSON.stringify(runs) !== before) {
    const kept = run();
    find("run").replaceChildren(...runs.map(({ name, state }) => element("option", { value: name }, `${name} (${state})`)));
    find("run").value = runs.some(({ name }) => name === kept) ? kept : listed.first;
    listCompared();
  }
  if (!runs.length) say("warn", `◌ ${listed.told || "no run yet"}; this page shows one as soon as it starts`);
  else if (follows && run() !== listed.first) choose(listed.first);
}

function choose(name) {
  find("run").value = name;
  own.clear();
  const box = [...find("compared").querySelectorAll("input")].find((input) => input.value === name);
  if (box) box.checked = true;
  refreshLive();
  refreshCurves();
}

function listCompared() {
  const checked = new Set(names());
  if (!checked.size && run()) checked.add(run());
  const legend = find("compared").firstElementChild;
  find("compared").replaceChildren(legend, ...runs.slice(0, 30).map(({ name }) => {
    const input = element("input", { type: "checkbox", value: name });
    input.checked = checked.has(name);
    return element("label", {}, input, element("span", { class: "mark" }), name);
  }));
}

function names() {
  return [...find("compared").querySelectorAll("input:checked")].map((input) => input.value);
}

// ---- now

const FIGURES = [
  ["stage", (row) => row.stage ?? "starting"], ["episodes", (row) => `${number(row.episodes ?? 0)} of ${number(row.episodes_target)}`],
  ["success, last 50", (row) => row.recent_success === undefined ? "-" : `${(100 * row.recent_success).toFixed(0)}%`],
  ["success / collision / timeout", (row) => ["success", "collision", "timeout"].map((name) => number(row[name] ?? 0)).join(" / ")],
  ["mean return", (row) => number(row.mean_return)], ["exploration", (row) => number(row.epsilon)],
  ["steps", (row) => number(row.env_steps ?? 0)], ["steps a second", (row) => number(row.env_steps_per_s)],
  ["updates, high / low", (row) => `${number(row.high_learner_updates ?? 0)} / ${number(row.low_learner_updates ?? 0)}`],
  ["loss, high / low", (row) => `${number(row.high_loss)} / ${number(row.low_loss)}`],
  ["replay, high / low", (row) => `${number(row.replay_high_size ?? 0)} / ${number(row.replay_low_size ?? 0)}`],
  ["weights behind, high / low", (row) => `${number(row.high_lag_versions ?? 0)} / ${number(row.low_lag_versions ?? 0)} versions`],
  ["merges", (row) => number(row.merges ?? 0)], ["processes replaced", (row) => number(row.restarts ?? 0)],
];

async function live() {
  if (!run()) return;
  const asked = run();
  const { state, view } = await ask(`live.json?run=${encodeURIComponent(asked)}&car=${encodeURIComponent(chosen)}`);
  if (asked !== run()) return;
  showStatus(state);
  if (state.figures) {
    showPairs(find("figures"), FIGURES.map(([name, text]) => [name, text(state.figures)]));
    setText(find("waits"), state.status === "ended" ? "" : `Waiting: ${state.waits.join("; ") || "nothing"}.`);
    remember(state.figures);
    showRoles(state.roles);
    showEvents(state.events);
  }
  showCars(state);
  if (view) await showView(view);
}

function showStatus(state) {
  if (state.status === "live") {
    if (state.silent_s > 3) say("warn", `◌ no word from the run for ${state.silent_s.toFixed(0)} s`);
    else say("good", state.key === state.run ? "● live" : `● live: ${state.key}`);
  } else if (state.status === "ended") say("good", "■ the run has ended");
  else if (state.status === "waiting") say("warn", `◌ ${state.told}`);
  else say("", "◌ connecting");
  document.title = `${state.run}: zsdist`;
  const there = Boolean(state.figures);
  find("roles-told").hidden = there;
  setText(find("roles-told"), there ? "" : "Roles are shown while a run goes on.");
  if (!there) {
    find("role-rows").replaceChildren();
    const entry = runs.find(({ name }) => name === state.run);
    showPairs(find("figures"), [["run", state.run], ["state", entry ? entry.state : state.status]]);
    setText(find("waits"), "");
  }
}

function remember(row) {
  const rows = own.get("rows") ?? [];
  if (rows.length && row.time_s - rows.at(-1).time_s < 1) return;
  rows.push(row);
  own.set("rows", rows.length > 1200 ? rows.filter((_, index) => index % 2) : rows);
}

// ---- roles and events

const ORDER = ["scheduler", "learner", "replay", "hub", "actor"];

function health(role) {
  if (!role.alive) return ["bad", "✕ gone"];
  if (role.silent_s === null) return ["warn", "◌ starting"];
  return role.silent_s > 3 ? ["warn", "◌ silent"] : ["good", "● well"];
}

function showRoles(roles) {
  const sorted = [...roles].sort((a, b) => ORDER.indexOf(a.role) - ORDER.indexOf(b.role) || a.id.localeCompare(b.id, "en", { numeric: true }));
  const body = find("role-rows");
  while (body.children.length > sorted.length) body.lastChild.remove();
  sorted.forEach((role, index) => {
    if (!body.children[index]) body.append(element("tr", {}, element("th", { scope: "row" }), ...Array.from({ length: 4 }, () => element("td"))));
    const [name, state, host, last, figures] = body.children[index].children, [kind, text] = health(role);
    setText(name, `${role.role} ${role.id}`);
    state.className = kind;
    setText(state, text);
    setText(host, role.host);
    setText(last, role.silent_s === null ? "-" : role.silent_s < 3 ? "now" : `${role.silent_s.toFixed(0)} s ago`);
    setText(figures, Object.entries(role.figures).map(([key, value]) => `${words(key)} ${typeof value === "number" ? number(value) : value}`).join(", "));
  });
}

function showEvents(events) {
  const text = (event) => Object.entries(event).filter(([key]) => !["time_s", "host", "pid", "id", "role", "event"].includes(key)).map(([key, value]) => `${words(key)} ${value}`).join(", ");
  const lines = [...events].reverse().map((event) => `${new Date(1000 * event.time_s).toLocaleTimeString()} ${words(String(event.event))}: ${text(event)}`);
  const list = find("event-rows");
  if (list.dataset.shown === lines.join("\n")) return;
  list.dataset.shown = lines.join("\n");
  list.replaceChildren(...(lines.length ? lines : ["None since this page was opened."]).map((line) => element("li", {}, line)));
}

// ---- curves

const charts = new Map();

async function curves() {
  const asked = names().slice(0, MOST_COMPARED);
  compared = asked.length ? await ask(`compare.json?${asked.map((name) => `run=${encodeURIComponent(name)}`).join("&")}`) : { runs: [], differences: {} };
  const rows = own.get("rows") ?? [];
  for (const name of asked) if (!compared.runs.some((one) => one.name === name) && rows.length) {
    const keys = Object.keys(rows.at(-1)).filter((key) => typeof rows.at(-1)[key] === "number");
    compared.runs.push({ name, curves: Object.fromEntries(keys.map((key) => [key, rows.map((row) => row[key] ?? null)])) });
  }
  drawCurves();
}

function drawCurves() {
  if (!compared) return;
  const axis = find("axis").value, all = new Set(compared.runs.flatMap((one) => Object.keys(one.curves)));
  const options = [...all].filter((name) => !(name in CURVES) && !["time_s", "row", axis].includes(name)).sort();
  if (find("more").options.length !== options.length + 1) {
    const kept = find("more").value;
    find("more").replaceChildren(element("option", { value: "" }, "none"), ...options.map((name) => element("option", { value: name }, words(name))));
    find("more").value = options.includes(kept) ? kept : "";
  }
  const more = find("more").value, wanted = { ...CURVES, ...(more ? { [more]: words(more) } : {}) };
  const placed = compared.runs.map((one, index) => ({ ...one, index, x: positions(one.curves, axis) }));
  const xs = extent(placed.map((one) => one.x));
  for (const [name, chart] of charts) if (!(name in wanted)) { chart.root.remove(); charts.delete(name); }
  for (const [name, title] of Object.entries(wanted)) {
    if (!charts.has(name)) {
      charts.set(name, new Chart(title, (share) => { find("cursor").value = 1000 * share; point(); }));
      find("charts").append(charts.get(name).root);
    }
    const drawn = placed.filter((one) => one.curves[name]?.some((value) => value !== null)).map((one) => ({ name: one.name, index: one.index, x: one.x, y: one.curves[name] }));
    charts.get(name).root.hidden = !drawn.length;
    charts.get(name).draw(drawn, xs);
  }
  for (const label of find("compared").querySelectorAll("label")) {
    const index = placed.findIndex((one) => one.name === label.firstChild.value);
    label.querySelector(".mark").replaceChildren(...(index < 0 ? [] : [swatch(index)]));
  }
  showDifferences();
  point();
}

function point() {
  const share = find("cursor").value / 1000;
  const xs = charts.size ? [...charts.values()][0].xs : [0, 1];
  const text = `${number(Math.round(xs[0] + share * (xs[1] - xs[0])))} ${find("axis").selectedOptions[0].textContent}`;
  setText(find("at"), text);
  find("cursor").setAttribute("aria-valuetext", text);
  for (const chart of charts.values()) chart.point(share);
}

function showDifferences() {
  const rows = Object.entries(compared.differences), many = compared.runs.length > 1;
  const head = element("tr", {}, element("th", { scope: "col" }, "setting"), ...compared.runs.map((one) => element("th", { scope: "col" }, one.name)));
  const body = rows.map(([name, values]) => element("tr", {}, element("th", { scope: "row" }, name), ...values.map((value) => element("td", {}, value))));
  const shown = !many ? [] : rows.length
    ? [element("h3", {}, "Settings in which they differ"), element("div", { class: "scroll", tabindex: "0", role: "group", "aria-label": "Settings in which the runs differ" }, element("table", {}, element("thead", {}, head), element("tbody", {}, ...body)))]
    : [element("p", {}, "They differ in no setting but the seed.")];
  find("differences").replaceChildren(...shown);
}

// ---- colours

const THEMES = ["automatic", "light", "dark"], dark = matchMedia("(prefers-color-scheme: dark)");
let theme = localStorage.getItem("colours") ?? "automatic";

function paint() {
  const shown = theme === "automatic" ? (dark.matches ? "dark" : "light") : theme;
  document.documentElement.dataset.colours = shown;
  setText(find("colours"), `Colours: ${theme}`);
  showView();
}

find("colours").addEventListener("click", () => {
  theme = THEMES[(THEMES.indexOf(theme) + 1) % THEMES.length];
  localStorage.setItem("colours", theme);
  paint();
});
dark.addEventListener("change", paint);
paint();

// ---- start

find("run").addEventListener("change", () => { follows = false; choose(run()); });
find("compared").addEventListener("change", (event) => {
  if (names().length > MOST_COMPARED) event.target.checked = false;
  refreshCurves();
});
for (const id of ["axis", "more"]) find(id).addEventListener("change", drawCurves);
find("cursor").addEventListener("input", point);
find("tiles").addEventListener("change", () => refreshLive());
const refreshLive = repeat(live, LIVE_MS);
const refreshCurves = repeat(curves, CURVES_MS);
repeat(refreshRuns, RUNS_MS);
