"use strict";
// The page: one pane per result, a common clock, and a sidebar with the certificates.

/** Creates an element with a class and a text. The text is never parsed as HTML. */
function element(tag, kind = "", text = "") {
  const made = document.createElement(tag);
  if (kind) made.className = kind;
  if (text) made.textContent = text;
  return made;
}

const byId = (id) => document.getElementById(id);
const data = JSON.parse(byId("data").textContent);
const horizon = Math.max(...data.results.map((result) => result.horizon));
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];

/** True if yaw gets its own plot, because it is so large that roll and pitch could not be read. */
const yawApart = data.results.some((result) => {
  const most = (i) => Math.max(...Array.from({ length: result.times }, (_, k) => Math.abs(result.angles[3 * k + i])));
  return most(2) > 3 * Math.max(most(0), most(1), 0.01);
});

const clock = { time: 0, playing: false, speed: 1, loop: true };

/** Formats a number with about three digits. */
function shown(value) {
  const size = Math.abs(value);
  // Rounding errors of zero.
  if (size < 1e-9) return "0";
  if (size < 1e-3 || size >= 1e5) return value.toExponential(1).replace("e-", "e−");
  return value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3);
}

const badge = ({ feasible, verdict }) => element("span", feasible ? "badge good" : "badge bad", verdict);

/** Pane of a result: heading, 3D view and plots. */
class Pane {
  constructor(result) {
    this.result = result;
    this.root = element("section", "pane");
    const about = element("div", "about");
    const facts = [`${result.robot} on ${result.terrain}`, ...result.about, `${shown(result.horizon)} s`];
    about.append(element("h2", "", result.name), badge(result.certificate), element("span", "", facts.join(" · ")));
    this.stage = element("div", "stage");
    const plots = element("div", "plots");
    this.root.append(about, this.stage, plots);
    byId("panes").append(this.root);
    this.makeView();
    this.plots = new PlotStack(plots, result, data, yawApart, (time) => setTime(time));
  }

  makeView() {
    const canvas = document.createElement("canvas");
    this.stage.append(canvas);
    try {
      this.view = new SceneView(canvas, this.result, data);
    } catch (error) {
      canvas.remove();
      this.stage.append(element("div", "message", `No 3D view: WebGL is not available in this browser (${error.message}). The plots below work.`));
      return;
    }
    const views = element("div", "views");
    for (const name of Object.keys(VIEWS)) {
      const button = element("button", "", name);
      button.type = "button";
      button.addEventListener("click", () => this.view.setView(name));
      views.append(button);
    }
    const legend = element("div", "legend");
    this.result.feet.forEach((foot, i) => {
      const name = element("span", "", foot.name);
      name.style.setProperty("--color", data.colors[i]);
      legend.append(name);
    });
    this.stage.append(legend, views);
  }
}

/** Section of the sidebar with the tables of a certificate. */
function certificateOf(result) {
  const { certificate } = result;
  const section = element("section");
  const title = element("h2", "", data.results.length > 1 ? `${result.name} ` : "Certificate ");
  title.append(badge(certificate));
  const terms = element("ul");
  certificate.terms.forEach((term) => terms.append(element("li", "", term)));
  const where = ({ time, foot }) => {
    const parts = [time === null ? "" : `at ${time.toFixed(2)} s`, foot === null ? "" : result.feet[foot].name];
    return parts.filter(Boolean).join(", ");
  };
  const worst = table(["Worst value", "value", "limit"], certificate.worst, (row) => ({
    broken: row.limit !== null && row.value > row.limit,
    cells: [[row.what, where(row)], [`${shown(row.value)} ${row.unit}`], [row.limit === null ? "–" : `${shown(row.limit)} ${row.unit}`]],
  }));
  const rows = table(["Rows", "checked", "violated"], certificate.families, (row) => ({
    broken: row.violated > 0,
    cells: [[row.about, row.worst ?? ""], [row.rows], [row.violated]],
  }));
  section.append(title, element("h3", "", "Limits"), terms);
  section.append(element("h3", "", "Over the whole motion"), worst, element("h3", "", "Constraint rows"), rows);
  return section;
}

function table(heads, rows, of) {
  const made = element("table");
  const head = made.createTHead().insertRow();
  heads.forEach((text, i) => head.append(element("th", i ? "number" : "", text)));
  const body = made.createTBody();
  for (const row of rows) {
    const { broken, cells } = of(row);
    const line = body.insertRow();
    if (broken) line.className = "broken";
    cells.forEach(([text, small], i) => {
      const cell = element("td", i ? "number" : "", String(text));
      if (small) cell.append(element("small", "", small));
      line.append(cell);
    });
  }
  return made;
}

const panes = data.results.map((result) => new Pane(result));
byId("sidebar").append(...data.results.map(certificateOf));

function icon(path) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 16 16");
  const shape = document.createElementNS("http://www.w3.org/2000/svg", "path");
  shape.setAttribute("d", path);
  svg.append(shape);
  return svg;
}

const ICONS = { play: "M3 1.5v13l11-6.5z", pause: "M3 1.5h3.6v13H3zM9.4 1.5H13v13H9.4z" };

function setPlaying(playing) {
  clock.playing = playing;
  byId("play").replaceChildren(icon(playing ? ICONS.pause : ICONS.play));
  byId("play").setAttribute("aria-label", playing ? "Pause" : "Play");
}

function setTime(time) {
  clock.time = Math.max(0, Math.min(horizon, time));
  byId("time").value = clock.time;
  byId("clock").textContent = `${clock.time.toFixed(2)} / ${horizon.toFixed(2)} s`;
  for (const { root, view, plots } of panes) {
    if (root.hidden) continue;
    view?.setTime(clock.time);
    plots.setTime(clock.time);
  }
}

function layOut() {
  const visible = panes.filter(({ root }) => !root.hidden);
  const ranges = sharedRanges(visible.map((pane) => pane.plots));
  visible.forEach(({ plots }) => plots.draw(horizon, ranges));
  setTime(clock.time);
}

function toggle(pane, chip) {
  const others = panes.some((other) => other !== pane && !other.root.hidden);
  if (!pane.root.hidden && !others) return;
  pane.root.hidden = !pane.root.hidden;
  chip.setAttribute("aria-pressed", String(!pane.root.hidden));
  layOut();
}

function showSidebar(open) {
  byId("sidebar").hidden = !open;
  byId("sidebar-button").setAttribute("aria-expanded", String(open));
  byId("sidebar-button").setAttribute("aria-pressed", String(open));
}

function setUp() {
  document.title = `${data.results.map((result) => result.name).join(", ")} · cregopt`;
  if (panes.length > 1) {
    panes.forEach((pane) => {
      const chip = element("button", "", pane.result.name);
      chip.type = "button";
      chip.setAttribute("aria-pressed", "true");
      chip.addEventListener("click", () => toggle(pane, chip));
      byId("chips").append(chip);
    });
  }
  const time = byId("time");
  time.max = horizon;
  time.addEventListener("input", () => setTime(Number(time.value)));
  byId("play").addEventListener("click", () => {
    if (!clock.playing && clock.time >= horizon) setTime(0);
    setPlaying(!clock.playing);
  });
  SPEEDS.forEach((speed) => {
    const option = element("option", "", `${speed}×`);
    option.value = speed;
    option.selected = speed === 1;
    byId("speed").append(option);
  });
  byId("speed").addEventListener("change", (event) => (clock.speed = Number(event.target.value)));
  byId("loop").addEventListener("change", (event) => (clock.loop = event.target.checked));
  for (const [layer, [text, shownFirst]] of Object.entries(LAYERS)) {
    const label = element("label");
    const box = element("input");
    box.type = "checkbox";
    box.checked = shownFirst;
    box.addEventListener("change", () => panes.forEach((pane) => pane.view?.show(layer, box.checked)));
    label.append(box, ` ${text}`);
    byId("layers").querySelector("div").append(label);
  }
  byId("sidebar-button").addEventListener("click", () => showSidebar(byId("sidebar").hidden));
  document.addEventListener("keydown", (event) => {
    if (["SELECT", "BUTTON", "SUMMARY"].includes(event.target.tagName) || event.ctrlKey || event.metaKey || event.altKey) return;
    const steps = { ArrowLeft: -1, ArrowRight: 1 };
    if (event.key === " ") byId("play").click();
    else if (event.key in steps) setTime(clock.time + steps[event.key] * (event.shiftKey ? 0.1 : 0.01));
    else if (event.key === "Home") setTime(0);
    else if (event.key === "End") setTime(horizon);
    else return;
    event.preventDefault();
  });
  new ResizeObserver(layOut).observe(byId("panes"));
  // With three or more results the panes need the width of the sidebar.
  showSidebar(panes.length < 3);
}

let last = null;
function tick(now) {
  // A tab in the background pauses, and does not jump when it is shown again.
  const passed = last === null ? 0 : Math.min((now - last) / 1000, 0.25);
  last = now;
  if (clock.playing) {
    const next = clock.time + passed * clock.speed;
    if (next < horizon) {
      setTime(next);
    } else if (clock.loop && horizon > 0) {
      setTime(next % horizon);
    } else {
      setTime(horizon);
      setPlaying(false);
    }
  }
  for (const { root, view } of panes) if (!root.hidden) view?.render();
  requestAnimationFrame(tick);
}

setUp();
layOut();
setPlaying(!matchMedia("(prefers-reduced-motion: reduce)").matches);
requestAnimationFrame(tick);
