// The sandbox: effects at the left, what becomes of the run at the right. Every move asks the server once; while an
// answer is under way only the newest move waits.

import { $, debounce, h, pageData, save } from "../lib/dom.js";
import { api, packed, problemNote, query } from "../lib/api.js";
import { closeOutside } from "../lib/chart-frame.js";
import { number } from "../lib/format.js";
import { keys } from "../lib/keys.js";
import { createMap } from "../lib/map.js";
import { createTimeCursor } from "../lib/timecursor.js";
import { createEffects } from "./sandbox-effects.js";
import { mountSandboxScene } from "./sandbox-scene.js";
import { humanOf } from "./sandbox-scale.js";
import { createStreams } from "./sandbox-streams.js";

const page = pageData();
const params = new URLSearchParams(location.search);
const LINES = {
  real: { label: "real", color: "--method-truth", dash: [], width: 1.75 },
  nominal: { label: "nominal", color: "--ink-3", dash: [6, 4], width: 1.5 },
  patched: { label: "patched", color: "--c2", dash: [], width: 2 },
  recorded: { label: "recorded sim", color: "--c4", dash: [2, 4], width: 1.75, robot: false },
};
const stretch = { start: given("start"), end: given("end") };
let clock = null;
let panel = null;
let streams = null;
let scene = null;
let map = null;
let busy = false;
let waiting = false;
let told = null;
let effects = new Map(); // the table, by id
let movedAt = null; // when the oldest move that is not yet on the screen was made
let measuring = false;
let stale = false; // the gap is of an older move

function given(name) {
  return params.has(name) && params.get(name) !== "" ? Number(params.get(name)) : null;
}

function effectsOfLink() {
  try {
    return JSON.parse(params.get("effects") ?? "{}");
  } catch {
    $("#problem").replaceChildren(problemNote({ detail: "The effects in this link are no JSON; all are neutral." }));
    return {};
  }
}

/* one move */

/** What is asked for: `lines`, paths and the columns in sight; else the gap alone. */
function wanted(effects, lines = true) {
  const view = clock && !clock.isFullRange ? { t0: clock.range[0], t1: clock.range[1] } : {};
  const simulator = page.simulators.length > 1 ? $("#simulator").value : null;
  const drawn = lines ? { ...view, points: 500, path_points: 1200, streams: streams ? streams.visible() : [] } : { streams: [] };
  return { ...page.source, ...stretch, ...drawn, simulator, effects, seed: seed(), noise: $("#noise").checked, lines, gap: !lines };
}

const seed = () => Math.max(0, Math.floor(Number($("#seed").value) || 0));

// Paths and streams first, as they are what the eye follows; the gap in a second question, while the next move may come.
async function move() {
  waiting = true;
  if (busy) return;
  busy = true;
  while (waiting) {
    waiting = false;
    const began = { event: movedAt ?? performance.now(), asked: performance.now() };
    movedAt = null;
    const note = setTimeout(() => ($("#told").textContent = "simulating … a simulator of your own takes its time"), 400);
    try {
      const answer = await packed("sandbox/simulate", wanted(panel.values));
      began.answered = performance.now();
      show(answer);
      await painted();
      tell(answer, began);
      scene?.show(answer.paths);
      measureGap();
      $("#problem").replaceChildren();
      panel.showProblem(null);
    } catch (error) {
      $("#problem").replaceChildren(problemNote(error));
      panel.showProblem(error.where?.parameter);
    }
    clearTimeout(note);
  }
  busy = false;
  remember();
}

async function measureGap() {
  stale = true;
  if (measuring) return;
  measuring = true;
  while (stale) {
    stale = false;
    try {
      paintGap(await packed("sandbox/simulate", wanted(panel.values, false)));
    } catch {
      // told with the lines, which were asked for with the same effects
    }
  }
  measuring = false;
}

/** After the next frame is on the screen. */
const painted = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done, 0)));

const moved = () => {
  movedAt ??= window.event?.timeStamp ?? performance.now();
  if (page.simulators.length > 1 && $("#simulator").value !== page.simulators[0]) moveLater();
  else move();
};
const moveLater = debounce(400, () => move());

function show(answer) {
  const paths = answer.paths.map((p) => ({ ...p, ...LINES[p.method], label: p.method === "real" ? p.label.toLowerCase() : LINES[p.method].label }));
  map.setPaths(paths, answer.source.beacons);
  streams.show(answer);
  told = answer.source;
}

function tell(answer, { event, asked, answered }) {
  const end = performance.now();
  const detail = { runtime_ms: answer.runtime_ms, request_ms: answered - asked, drawing_ms: end - answered };
  performance.measure("sandbox-move", { start: event, end, detail });
  const { start, end: last, full } = told;
  const part = last - start < full[1] - full[0] - 1e-6 ? `${number(start)} to ${number(last)} s of ${number(full[1] - full[0], 4)} s are simulated (start= and end= in the address choose others). ` : "";
  $("#told").textContent = `${part}${Math.round(end - event)} ms from this move to its picture, ${number(answer.runtime_ms, 2)} ms of it simulation.`;
  document.documentElement.dataset.moves = String(Number(document.documentElement.dataset.moves ?? 0) + 1);
}

/* the sentence and the gap */

const words = (values) => Object.entries(values).map(([id, v]) => `${id.replaceAll("_", " ")} ${Object.entries(v).map(([name, x]) => told4(id, name, x)).join(", ")}`);

/** Four digits and the unit that its slider has. */
function told4(id, name, value) {
  if (typeof value !== "number") return value;
  const human = humanOf(effects.get(id)?.parameters.find((p) => p.name === name)?.unit ?? "");
  return `${Number((value * human.factor).toPrecision(4))}${human.unit && human.unit !== "-" ? ` ${human.unit}` : ""}`;
}

function paintGap({ gap, no_gap: why }) {
  streams.showGap(gap);
  const names = words(panel.values);
  const box = $("#gap");
  box.hidden = false;
  if (!gap) {
    box.replaceChildren(h("span", { class: "dim" }, `No gap number: ${why}.`));
    $("#verdict").textContent = names.length ? `With ${names.join("; ")}: patched beside nominal.` : "Move an effect: the path and every stream follow.";
    return;
  }
  const most = Math.max(gap.before, gap.now, gap.floor) * 1.02;
  const bar = (name, value) => {
    const part = h("i", { class: name });
    if (name === "floor") part.style.left = `${(100 * value) / most}%`;
    else part.style.width = `${(100 * value) / most}%`;
    return part;
  };
  const bars = [["before", gap.before], ["now", gap.now]].sort((a, b) => b[1] - a[1]);
  box.replaceChildren(
    h("span", { "data-term": "sandbox_gap" }, "Gap ", h("b", { id: "gap-now" }, number(gap.now)), " × the noise"),
    h("span", { class: "dim" }, `nominal `, h("span", { id: "gap-before" }, number(gap.before)), `, floor ${number(gap.floor)}`),
    h("div", { class: "gap-bar", role: "img", "aria-label": `gap ${number(gap.now)}, nominal ${number(gap.before)}, floor ${number(gap.floor)}` }, bars.map(([n, v]) => bar(n, v)), bar("floor", gap.floor)),
    h("span", { class: "dim" }, gap.shrink === null ? "nothing above the floor" : gap.shrink < -1 ? `${number(gap.now / gap.before)} times as far` : `${number(Math.abs(100 * gap.shrink))} % ${gap.shrink < 0 ? "more" : "of it gone"}`),
  );
  const verb = gap.now < gap.before * 0.995 ? "falls" : gap.now > gap.before * 1.005 ? "rises" : "stays";
  $("#verdict").textContent = names.length ? `With ${names.join("; ")} the gap ${verb}${verb === "stays" ? " at" : ` from ${number(gap.before)} to`} ${number(gap.now)} times the noise (floor ${number(gap.floor)}).` : `The simulator as it is: ${number(gap.before)} times the noise, floor ${number(gap.floor)}. Move an effect.`;
}

/* the link, and what leaves the page */

function address() {
  const effects = panel.values;
  const now = { ...page.source, effects: Object.keys(effects).length ? JSON.stringify(effects) : "", noise: $("#noise").checked ? "1" : "", seed: seed() || "", start: stretch.start, end: stretch.end };
  if (page.simulators.length > 1 && $("#simulator").value !== page.simulators[0]) now.simulator = $("#simulator").value;
  if (!clock.isFullRange) Object.assign(now, { t0: clock.range[0].toFixed(3), t1: clock.range[1].toFixed(3) });
  if (clock.time > clock.full[0]) now.t = clock.time.toFixed(3);
  return `/sandbox?${query(now)}`;
}

const remember = debounce(150, () => history.replaceState(null, "", address()));

async function copied(button, text) {
  await navigator.clipboard.writeText(text);
  const label = button.textContent;
  button.textContent = "Copied";
  setTimeout(() => (button.textContent = label), 1500);
}

const json = () => JSON.stringify({ effects: panel.values }, null, 2);

function command() {
  const source = page.source.run ?? `scenario:${page.source.scenario}`;
  const simulator = new URL(address(), location.href).searchParams.get("simulator");
  const { start, end, full, placed } = told;
  const options = [
    $("#noise").checked || simulator ? "" : " --no-noise",
    placed || start > full[0] ? ` --start ${start}` : "",
    end < full[1] ? ` --end ${end}` : "",
    simulator ? ` --simulator ${simulator}` : "",
  ].join("");
  return `echo '${JSON.stringify({ effects: panel.values })}' > effects.json\ndriftscope simulate ${source} --effects effects.json --seed ${seed()}${options} --out simulated\n`;
}

async function exported(target) {
  const note = $("#export-note");
  note.hidden = false;
  try {
    const made = await api(`exports/effects/${target.name}`, { json: { ...page.source, effects: panel.values, form: "json" } });
    save(new Blob([made.text], { type: made.media_type }), made.file_name);
    const lists = [["roughly", made.nearest], ["not", made.missing]].flatMap(([how, list]) => Object.entries(list).map(([e, why]) => [h("dt", {}, `${how}: ${e}`), h("dd", {}, why)]));
    note.replaceChildren(h("p", {}, `${made.file_name}: ${target.what}. Modelled: ${made.expressed.join(", ") || "nothing beyond the nominal robot"}.`), lists.length ? h("dl", {}, lists) : "");
  } catch (error) {
    note.replaceChildren(problemNote(error));
  }
}

function startBar() {
  const option = (value, label, on) => h("option", { value, selected: on }, label);
  $("#source").append(
    h("optgroup", { label: "Runs" }, page.runs.map((r) => option(`run=${r.id}`, r.name, r.id === page.source.run))),
    h("optgroup", { label: "Scenarios" }, page.scenarios.map((s) => option(`scenario=${s.name}`, s.label, s.name === page.source.scenario))),
  );
  $("#source").addEventListener("change", () => {
    const effects = panel ? JSON.stringify(panel.values) : params.get("effects");
    location.href = `/sandbox?${$("#source").value}&${query({ effects: effects === "{}" ? "" : effects })}`;
  });
  $("#simulator").hidden = page.simulators.length < 2;
  $("#simulator").append(...page.simulators.map((s) => option(s, s === "sim" ? "sim: recorded beside it" : s, s === params.get("simulator"))));
  $("#noise").checked = params.get("noise") === "1";
  $("#seed").value = params.get("seed") ?? "0";
  for (const id of ["#noise", "#seed", "#simulator"]) $(id).addEventListener("change", () => moved());
  $("#copy-link").addEventListener("click", (e) => copied(e.target, new URL(address(), location.href).href));
  $("#copy-json").addEventListener("click", (e) => copied(e.target, json()));
  $("#copy-command").addEventListener("click", (e) => copied(e.target, command()));
  const menu = $("#export");
  $(".menu-list", menu).append(...page.targets.map((t) => h("button", { type: "button", "data-target": t.name, title: t.what, onclick: () => ((menu.open = false), exported(t)) }, t.label)));
  closeOutside(menu);
}

function startClock(source) {
  clock = createTimeCursor({ t0: source.start, t1: source.end });
  if (given("t0") !== null) clock.setRange(given("t0"), given("t1") ?? source.end);
  const t = given("t") ?? given("t0");
  if (t !== null) clock.setTime(t);
  const refine = debounce(60, () => move());
  const paint = () => {
    $("#time").value = String((1000 * (clock.time - source.start)) / (source.end - source.start));
    $("#now").textContent = `${clock.time.toFixed(2)} s`;
    $("#play").textContent = clock.playing ? "Pause" : "Play";
  };
  $("#time").addEventListener("input", () => clock.setTime(source.start + (Number($("#time").value) / 1000) * (source.end - source.start)));
  $("#play").addEventListener("click", () => clock.toggle());
  clock.subscribe((what) => {
    paint();
    if (what === "range") refine();
    if (what === "time" || what === "range") remember();
  });
  paint();
  keys("Sandbox", {
    " ": ["play and pause", () => clock.toggle(), "space"],
    ",": ["a step back", () => clock.step(-1)],
    ".": ["a step on", () => clock.step(1)],
    r: ["reset all effects", () => panel.reset()],
    n: ["noise on and off", () => (($("#noise").checked = !$("#noise").checked), moved())],
    e: ["export", () => (($("#export").open = true), $("#export button").focus())],
    Home: ["whole time", () => clock.resetRange()],
  });
}

/** Which line is which, for map and 3D. */
function tellLines({ paths }) {
  const line = ({ method, label }) => {
    const { color, dash } = LINES[method];
    const mark = h("i", { class: dash.length ? "dashed" : "" });
    mark.style.borderColor = `var(${color})`;
    return h("span", {}, mark, method === "real" ? label.toLowerCase() : LINES[method].label);
  };
  $("#lines").replaceChildren(...paths.map(line));
}

/** What the run reaches: the middle of its paths, their size, its time. */
function reachOf(answer) {
  const of = (axis) => answer.paths.flatMap((p) => Array.from(p[axis])).filter((v) => v !== null);
  const [xs, ys] = [of("x"), of("y")];
  const ends = (list) => list.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
  const [[x0, x1], [y0, y1]] = [ends(xs), ends(ys)];
  return { x: (x0 + x1) / 2, y: (y0 + y1) / 2, size: Math.max(x1 - x0, y1 - y0, 1), t0: answer.source.start, t1: answer.source.end };
}

async function start() {
  startBar();
  try {
    const [table, first] = await Promise.all([api("effects"), packed("sandbox/simulate", { ...wanted({}), simulator: null })]);
    effects = new Map(table.items.map((e) => [e.id, e]));
    startClock(first.source);
    panel = createEffects($("#effects"), { effects: table.items, source: first.source, reach: reachOf(first), values: effectsOfLink(), onMove: moved });
    const refuse = () => panel.refuse(page.refused[$("#simulator").value] ?? {});
    $("#simulator").addEventListener("change", refuse);
    refuse();
    map = createMap($("#map"), { clock, subject: first.source.name, fileName: "sandbox" });
    map.setLead("patched");
    streams = createStreams($("#streams"), { clock, source: first.source, lines: LINES, onSight: () => move() });
    scene = mountSandboxScene($("#scene"), page.source.run ?? `scenario-${page.source.scenario}`, first.source.reference, clock);
    tellLines(first);
    show(first); // there is a picture even where what the link asks for is refused
    await move();
  } catch (error) {
    $("#problem").replaceChildren(problemNote(error));
  }
  document.documentElement.dataset.ready = "sandbox";
}

start();
