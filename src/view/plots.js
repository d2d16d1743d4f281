"use strict";
// Plots over time. The curves are drawn once; a cursor and the values at the cursor follow the clock.

const GUTTER = { left: 46, right: 12, top: 19, bottom: 3, axis: 32 };
const LEAST_HEIGHT = 52;
const INK = { text: "#5b6876", grid: "#e6eaee", axis: "#aab4bf", limit: "#b3261e", base: ["#1d2733", "#8a5a00", "#5b6876"] };

/** About `most` round numbers in a range, and their number of digits after the decimal point. */
function ticks(low, high, most) {
  const rough = (high - low) / Math.max(1, most);
  const ten = 10 ** Math.floor(Math.log10(rough));
  const kind = [1, 2, 2.5, 5, 10].find((k) => k * ten >= rough * 0.999);
  const step = kind * ten;
  const values = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) values.push(i * step);
  // A single tick does not show the scale of the axis.
  if (values.length < 2 && most < 9) return ticks(low, high, most + 1);
  return { values, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9) + (kind === 2.5 ? 1 : 0)) };
}

const degrees = (rad) => (rad * 180) / Math.PI;

/** Plots of a result: title, unit and curves. A curve is a function of the index of a sample. */
function panelsOf(result, data, yawApart) {
  const axis = (values, size, i) => (k) => values[size * k + i];
  const feet = (of) => result.feet.map((foot, i) => ({ name: foot.name, color: data.colors[i], at: of(foot) }));
  const base = (names, of) => names.map((name, i) => ({ name, color: INK.base[i], dash: [[], [5, 3], [1.5, 2.5]][i], at: of(i) }));
  const angle = (i) => (k) => degrees(result.angles[3 * k + i]);
  const attitude = yawApart
    ? [
        { title: "Roll and pitch", unit: "deg", digits: 1, curves: base(["roll", "pitch"], angle) },
        { title: "Yaw", unit: "deg", digits: 1, curves: base(["yaw"], () => angle(2)) },
      ]
    : [{ title: "Attitude", unit: "deg", digits: 1, curves: base(["roll", "pitch", "yaw"], angle) }];
  const speed = (k) => Math.hypot(...[0, 1, 2].map((i) => result.velocity[3 * k + i]));
  return [
    { title: "Gait", bars: true, curves: feet(() => null) },
    { title: "Normal force", unit: "N", digits: 0, zero: true, own: true, limit: result.force_limit, curves: feet((f) => axis(f.normal_force, 1, 0)) },
    {
      title: "Friction utilisation", unit: "%", digits: 0, zero: true, limit: 100, cap: 200,
      curves: feet((f) => (k) => (f.friction_use[k] === null ? null : 100 * f.friction_use[k])),
    },
    { title: "Height of the base", unit: "m", digits: 3, own: true, curves: base(["height"], () => axis(result.position, 3, 2)) },
    ...attitude,
    { title: "Speed of the base", unit: "m/s", digits: 2, zero: true, curves: base(["speed"], () => speed) },
  ];
}

/** Smallest and largest value of a plot. Values above its cap are not shown. */
function rangeOf(panel, count) {
  let [low, high] = panel.zero ? [0, 0] : [Infinity, -Infinity];
  if (panel.limit !== undefined) high = panel.limit;
  for (const { at } of panel.curves) {
    for (let k = 0; at && k < count; k++) {
      const value = at(k);
      if (value === null) continue;
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
  }
  return [low, Math.min(high, panel.cap ?? high)];
}

/** Key of plots that share a range of values: plots of the same quantity; for forces and heights only of robots with the same weight. */
const rangeKey = (panel, result) => (panel.own ? `${panel.title} ${result.weight.toPrecision(4)}` : panel.title);

/** Common ranges of the plots of several results, so that they can be compared. */
function sharedRanges(stacks) {
  const ranges = {};
  for (const { result, panels } of stacks) {
    for (const panel of panels.filter((p) => !p.bars)) {
      const [low, high] = rangeOf(panel, result.times);
      const key = rangeKey(panel, result);
      const known = ranges[key] ?? [low, high];
      ranges[key] = [Math.min(low, known[0]), Math.max(high, known[1])];
    }
  }
  for (const [key, [low, high]] of Object.entries(ranges)) {
    const pad = 0.06 * Math.max(high - low, 1e-3 * Math.abs(high), 1e-3);
    ranges[key] = [low === 0 ? 0 : low - pad, high + pad];
  }
  return ranges;
}

/** Column with the plots of one result. */
class PlotStack {
  constructor(container, result, data, yawApart, onSeek) {
    this.container = container;
    this.result = result;
    this.data = data;
    this.panels = panelsOf(result, data, yawApart);
    this.area = element("div", "area");
    this.canvas = document.createElement("canvas");
    this.cursor = element("div", "cursor");
    this.area.append(this.canvas, this.cursor);
    for (const panel of this.panels) {
      panel.heading = element("div", "heading");
      const title = element("span");
      title.append(element("b", "", panel.title), element("i", "", panel.unit ? ` (${panel.unit})` : ""));
      const values = element("div", "values");
      panel.values = panel.curves.map(({ name, color }) => {
        const value = element("span");
        value.style.color = color;
        values.append(value);
        return { value, name };
      });
      panel.heading.append(title, values);
      panel.heading.style.left = `${GUTTER.left}px`;
      this.area.append(panel.heading);
    }
    container.append(this.area);
    const seek = (event) => {
      const box = this.area.getBoundingClientRect();
      const part = (event.clientX - box.left - GUTTER.left) / (box.width - GUTTER.left - GUTTER.right);
      onSeek(Math.max(0, Math.min(1, part)) * this.horizon);
    };
    this.area.addEventListener("pointerdown", (event) => {
      this.area.setPointerCapture(event.pointerId);
      seek(event);
    });
    this.area.addEventListener("pointermove", (event) => {
      if (event.buttons & 1) seek(event);
    });
  }

  /** Lays out and draws all plots, for a time range from 0 to `horizon`, s, and common ranges of values. */
  draw(horizon, ranges) {
    Object.assign(this, { horizon, ranges });
    const width = this.container.clientWidth;
    if (!width) return;
    const bars = Math.max(LEAST_HEIGHT, GUTTER.top + 13 * this.result.feet.length + 6);
    const others = this.panels.length - 1;
    // The plots fill the available height, and scroll if it is too small.
    const room = matchMedia("(max-width: 820px)").matches ? 0 : this.container.clientHeight;
    const each = Math.max(LEAST_HEIGHT, Math.min(150, (room - bars - GUTTER.axis) / others));
    const height = bars + others * each + GUTTER.axis;
    const ratio = Math.min(devicePixelRatio, 2);
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    this.canvas.style.height = `${height}px`;
    const g = this.canvas.getContext("2d");
    g.scale(ratio, ratio);
    g.font = "11px system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif";
    g.textBaseline = "middle";
    this.left = GUTTER.left;
    this.width = width - GUTTER.left - GUTTER.right;
    const x = (time) => this.left + (time / horizon) * this.width;
    const times = ticks(0, horizon, this.width / 70);
    let top = 0;
    for (const panel of this.panels) {
      const tall = panel.bars ? bars : each;
      const box = { top: top + GUTTER.top, bottom: top + tall - GUTTER.bottom };
      panel.heading.style.top = `${top + 3}px`;
      g.strokeStyle = INK.grid;
      g.lineWidth = 1;
      for (const time of times.values) line(g, [x(time), box.top], [x(time), box.bottom]);
      if (panel.bars) this.drawBars(g, panel, box, x);
      else this.drawCurves(g, panel, box, x);
      top += tall;
    }
    g.fillStyle = INK.text;
    g.textAlign = "center";
    for (const time of times.values) g.fillText(time.toFixed(times.digits), x(time), top + 8);
    g.fillText("time (s)", this.left + this.width / 2, top + 24);
    this.cursor.style.bottom = `${GUTTER.axis}px`;
  }

  drawBars(g, panel, { top, bottom }, x) {
    const row = (bottom - top) / panel.curves.length;
    this.result.feet.forEach((foot, i) => {
      const y = top + i * row;
      g.fillStyle = "#f1f3f6";
      g.fillRect(this.left, y + 1.5, x(this.result.horizon) - this.left, row - 3);
      g.fillStyle = panel.curves[i].color;
      for (const [start, end] of foot.stances) g.fillRect(x(start), y + 1.5, Math.max(1, x(end) - x(start)), row - 3);
      g.textAlign = "right";
      g.fillText(foot.name, this.left - 6, y + row / 2);
    });
  }

  drawCurves(g, panel, { top, bottom }, x) {
    const [low, high] = this.ranges[rangeKey(panel, this.result)];
    const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - top);
    const marks = ticks(low, high, Math.max(2, (bottom - top) / 26));
    g.fillStyle = INK.text;
    g.textAlign = "right";
    for (const value of marks.values) {
      g.strokeStyle = value === 0 ? INK.axis : INK.grid;
      line(g, [this.left, y(value)], [this.left + this.width, y(value)]);
      g.fillText(value.toFixed(marks.digits).replace("-", "−"), this.left - 6, y(value));
    }
    if (panel.limit !== undefined) {
      g.strokeStyle = INK.limit;
      g.setLineDash([5, 4]);
      line(g, [this.left, y(panel.limit)], [this.left + this.width, y(panel.limit)]);
      g.setLineDash([]);
    }
    g.save();
    g.beginPath();
    g.rect(this.left, top - 1, this.width, bottom - top + 2);
    g.clip();
    const { times, horizon } = this.result;
    for (const { color, at, dash } of panel.curves) {
      g.strokeStyle = color;
      g.lineWidth = 1.4;
      g.setLineDash(dash ?? []);
      g.beginPath();
      let pen = false;
      for (let k = 0; k < times; k++) {
        const value = at(k);
        if (value === null) {
          pen = false;
          continue;
        }
        const place = [x(k + 1 === times ? horizon : k / this.data.rate), y(value)];
        pen ? g.lineTo(...place) : g.moveTo(...place);
        pen = true;
      }
      g.stroke();
    }
    g.restore();
  }

  setTime(time) {
    if (!this.horizon) return;
    const own = Math.min(time, this.result.horizon);
    this.cursor.style.transform = `translateX(${this.left + (time / this.horizon) * this.width}px)`;
    const { index, weight } = sampleAt(this.result, this.data.rate, own);
    const nearest = index + (weight > 0.5 ? 1 : 0);
    for (const panel of this.panels) {
      if (panel.bars) continue;
      panel.values.forEach(({ value, name }, i) => {
        const now = panel.curves[i].at(nearest);
        const text = now === null ? "–" : now.toFixed(panel.digits).replace(/^-(0(\.0*)?)$/, "$1").replace("-", "−");
        const full = `${name} ${text}`;
        if (value.textContent !== full) value.textContent = full;
      });
    }
  }
}

function line(g, from, to) {
  g.beginPath();
  g.moveTo(...from);
  g.lineTo(...to);
  g.stroke();
}
