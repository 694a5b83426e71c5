"use strict";
// Filter of listed runs; cross-hair, zoom and legends of plots. The data are the drawn curves: a drawing has 64000 units a side.
(() => {
  const SIDE = 64000;
  const MINUS = "\u2212";
  const make = (tag, name, parent) => {
    const element = document.createElement(tag);
    element.className = name;
    parent.append(element);
    return element;
  };
  const fixed = (value, decimals) =>
    (value + 0).toFixed(Math.min(Math.max(decimals, 0), 12)).replace("-", MINUS).replace(/^\u2212(0\.?0*)$/, "$1");
  // A value in as few digits as distinguish it on an axis of this length.
  const known = (value, length) => {
    const step = length / SIDE;
    const many = clamped(Math.ceil(-Math.log10(step)), 0, 12);
    let few = 0;
    while (few < many && Math.abs(value - Number(value.toFixed(few))) > step / 2) few++;
    return fixed(value, few);
  };
  const clamped = (value, low, high) => Math.min(Math.max(value, low), high);
  const closest = (values, x) => values.filter(Number.isFinite).sort((a, b) => Math.abs(a - x) - Math.abs(b - x))[0];

  // Samples of a path, with NaN between two that are not joined.
  function samples(path) {
    const x = [], y = [];
    let [right, down] = [0, 0];
    for (const [, command, text] of path.getAttribute("d").matchAll(/([a-zA-Z])([^a-zA-Z]*)/g)) {
      const numbers = (text.match(/-?\d+/g) || []).map(Number);
      if (command === "M" && x.length) { x.push(NaN); y.push(NaN); }
      if (command === "M") [right, down] = [0, 0];
      if (!"Mml".includes(command)) continue;
      for (let place = 0; place + 1 < numbers.length; place += 2) {
        right += numbers[place];
        down += numbers[place + 1];
        x.push(right);
        y.push(down);
      }
    }
    return { x, y };
  }

  // Round values on an axis, as plot/ticks.rs has them.
  function ticks(low, high) {
    const rough = (high - low) / 6;
    const decade = 10 ** Math.floor(Math.log10(rough));
    const step = ([1, 2, 5, 10].find((factor) => factor * decade >= rough * 0.999) || 10) * decade;
    const decimals = clamped(-Math.floor(Math.log10(step) + 1e-9), 0, 9);
    const found = [];
    for (let number = Math.ceil(low / step - 1e-9); found.length < 20 && number * step <= high + step * 1e-9; number++) {
      const value = number * step;
      const is_large = Math.abs(value) >= 1e5 && step >= 1e4;
      found.push([value, is_large ? value.toExponential().replace("+", "").replace("-", MINUS) : fixed(value, decimals)]);
    }
    return found;
  }

  class Curve {
    constructor(path, key) {
      this.path = path;
      this.label = key.textContent;
      this.button = make("button", "", key.parentNode);
      this.button.type = "button";
      this.button.setAttribute("aria-pressed", "true");
      this.button.append(...key.childNodes);
      this.value = make("b", "", this.button);
      key.replaceWith(this.button);
      this.is_shown = true;
      // The page draws single points as lines of no length.
      this.is_points = path.classList.contains("points");
    }
    get data() {
      return (this.read ||= samples(this.path));
    }
    // Place of the first sample beyond x. A gap has the x of the sample before it.
    after(x) {
      const all = this.data.x;
      let [low, high] = [0, all.length];
      while (low < high) {
        const middle = (low + high) >> 1;
        const at = Number.isNaN(all[middle]) ? all[middle - 1] : all[middle];
        if (at <= x) low = middle + 1; else high = middle;
      }
      return low;
    }
    // Point at x: of a level stretch, else the nearest sample, or null in a gap.
    at(x, reach) {
      const data = this.data;
      let after = this.after(x), before = after - 1;
      const is_gap = Number.isNaN(data.x[before]);
      if (is_gap) before--;
      const level = data.y[before];
      const is_level = data.y[after] === level && !this.is_points;
      if (!is_gap && data.x[before] <= x && (data.x[before] === x || is_level)) return { x, y: level };
      const near = [before, after].filter((place) => place >= 0 && place < data.x.length);
      const distance = (place) => Math.abs(data.x[place] - x);
      const best = near.sort((a, b) => distance(a) - distance(b))[0];
      const is_joined = near.length === 2 && !is_gap && !this.is_points;
      if (best === undefined || (!is_joined && distance(best) > reach)) return null;
      return { x: data.x[best], y: data.y[best] };
    }
    nearest(x) {
      const { x: all } = this.data, after = this.after(x);
      return closest([after - 2, after - 1, after].map((place) => all[place]), x);
    }
    // The next sample in a direction.
    step(x, direction) {
      const { x: all } = this.data;
      let place = this.after(x);
      if (direction < 0) for (place--; place >= 0 && !(all[place] < x); place--);
      else while (place < all.length && !(all[place] > x)) place++;
      return all[place];
    }
  }

  class Plot {
    constructor(figure) {
      this.figure = figure;
      this.axes = figure.querySelector(".axes");
      this.svg = figure.querySelector("svg");
      this.grid = figure.querySelector(".grid");
      const [left, right, bottom, top] = figure.dataset.view.split(" ").map(Number);
      Object.assign(this, { left, right, bottom, top });
      this.is_plane = figure.classList.contains("plane");
      this.is_log = figure.classList.contains("log");
      this.title = figure.querySelector("strong").textContent;
      this.x_label = figure.querySelector(".x-label").textContent;
      this.unit = figure.dataset.unit || "";
      const paths = [...this.svg.querySelectorAll("path:not(.grid)")];
      const keys = [...figure.querySelectorAll(".legend > span")];
      this.curves = keys.map((key, number) => new Curve(paths[number], key));
      for (const curve of this.curves) {
        curve.dot = make("i", `dot ${curve.path.classList[0]}`, this.axes);
        curve.button.addEventListener("click", () => this.toggle(curve));
      }
      this.hair = make("div", "hair", this.axes);
      this.stamp = make("span", "", this.hair);
      this.selection = make("div", "selection", this.axes);
      this.reset = make("button", "reset", figure.querySelector("figcaption"));
      this.reset.type = "button";
      this.reset.textContent = "whole";
      this.notes = [...figure.querySelectorAll(".note")].map((note) => [note.dataset.at.split(" ").map(Number), note]);
      this.axes.tabIndex = 0;
      this.axes.setAttribute("role", "application");
      this.axes.setAttribute("aria-label", `${this.title}. Arrows: cross-hair. Plus, minus, Escape: zoom.`);
      this.whole = [0, 0, SIDE, SIDE];
      this.view = this.whole;
    }
    get shown() { return this.curves.filter((curve) => curve.is_shown); }
    to_value(x) { return this.left + (x / SIDE) * (this.right - this.left); }
    to_unit(value) { return ((value - this.left) / (this.right - this.left)) * SIDE; }
    height(y) {
      const value = this.top - (y / SIDE) * (this.top - this.bottom);
      // Below a count of one, whose logarithm is 0, is an empty bin.
      return this.is_log ? (value < 0 ? 0 : Math.round(10 ** value)) : value;
    }
    // The stretch that is shown.
    get stretch() { return [this.view[0], this.view[0] + this.view[2]].map((x) => this.to_value(x)); }
    is_in_window() {
      const box = this.axes.getBoundingClientRect();
      return box.bottom > 0 && box.top < innerHeight;
    }
    toggle(curve) {
      curve.is_shown = !curve.is_shown;
      curve.path.classList.toggle("off", !curve.is_shown);
      curve.button.setAttribute("aria-pressed", String(curve.is_shown));
      if (this.view !== this.whole) this.look(this.stretch);
      this.point(null);
    }
    // Shows the part of a stretch that the plot has, or everything if it has none.
    look(stretch) {
      const from = stretch ? clamped(this.to_unit(stretch[0]), 0, SIDE) : 0;
      const until = stretch ? clamped(this.to_unit(stretch[1]), 0, SIDE) : SIDE;
      const is_whole = until - from < 1e-6 * SIDE || until - from > 0.9999 * SIDE;
      this.view = is_whole ? this.whole : [from, 0, until - from, SIDE];
      if (!is_whole && !this.is_log) this.fit();
      this.figure.classList.toggle("zoomed", !is_whole);
      this.draw();
    }
    // Fits the height to the samples in the stretch.
    fit() {
      let [low, high] = [Infinity, -Infinity];
      const [from, , width] = this.view;
      for (const curve of this.shown) {
        const { x, y } = curve.data;
        const first = Math.max(curve.after(from) - 1, 0), end = Math.min(curve.after(from + width) + 1, x.length);
        for (let place = first; place < end; place++) {
          if (Number.isNaN(x[place])) continue;
          // A neighbour outside counts as far as the line to it is inside.
          let height = y[place];
          const inner = x[place] < from ? place + 1 : place - 1;
          const edge = clamped(x[place], from, from + width);
          if (edge !== x[place]) {
            if (!(inner >= first && inner < end) || Number.isNaN(x[inner]) || curve.is_points) continue;
            height = y[place] + ((y[inner] - y[place]) * (edge - x[place])) / (x[inner] - x[place]);
          }
          low = Math.min(low, height);
          high = Math.max(high, height);
        }
      }
      if (low > high) return;
      const room = Math.max((high - low) * 0.05, 1);
      this.view = [from, low - room, width, high - low + 2 * room];
    }
    draw() {
      const [left, up, width, height] = this.view;
      this.svg.setAttribute("viewBox", this.view.join(" "));
      const value = (y) => this.top - (y / SIDE) * (this.top - this.bottom);
      const down = (y) => ((this.top - y) / (this.top - this.bottom)) * SIDE;
      let along = ticks(...this.stretch);
      const long = along.some(([, label]) => label.length > 7);
      const labels = along.filter((_, number) => !long || number % 2 === 0);
      const powers = [...Array(12).keys()].filter((power) => power >= this.bottom && power <= this.top);
      const upright = this.is_log ? powers.map((power) => [power, fixed(10 ** power, 0)]) : ticks(value(up + height), value(up));
      this.grid.setAttribute("d", along.map(([x]) => `M${this.to_unit(x)} ${up}v${height}`).join("")
        + upright.map(([y]) => `M${left} ${down(y)}h${width}`).join(""));
      const put = (name, side, all) => {
        const axis = this.axes.querySelector(name);
        axis.replaceChildren();
        for (const [place, label] of all) {
          const span = make("span", "", axis);
          span.style[side] = `${place}%`;
          span.textContent = label;
        }
      };
      put(".x", "left", labels.map(([x, label]) => [((this.to_unit(x) - left) / width) * 100, label]));
      put(".y", "top", upright.map(([y, label]) => [((down(y) - up) / height) * 100, label]));
    }
    place(element, x, y) {
      const [left, up, width, height] = this.view;
      const [right, down] = [(x - left) / width, (y - up) / height];
      element.style.left = `${right * 100}%`;
      element.style.top = `${clamped(down, 0, 1) * 100}%`;
      element.hidden = right < 0 || right > 1;
    }
    // Moves the cross-hair to a value of x, or removes it for null. Returns the spoken values.
    point(value, slack = 0) {
      this.figure.classList.toggle("pointed", value !== null);
      const said = [];
      for (const curve of this.curves) {
        curve.value.textContent = "";
        curve.dot.hidden = true;
        if (value === null || !curve.is_shown) continue;
        const x = this.to_unit(value);
        const at = x < -1 || x > SIDE + 1 ? null : curve.at(x, this.view[2] / 100);
        const is_near = at && Math.abs(at.x - x) > 1 + (slack / (this.right - this.left)) * SIDE;
        curve.value.textContent = at ? (is_near ? "\u2248 " : "") + this.reading(at.y) : "\u2013";
        if (at) this.place(curve.dot, at.x, at.y);
        said.push(`${curve.label} ${at ? curve.value.textContent + " " + this.unit : "none"}`);
      }
      if (value === null) return "";
      this.place(this.hair, this.to_unit(value), 0);
      this.stamp.textContent = this.along(value, slack);
      return `${this.title} at ${this.stamp.textContent}: ${said.join(", ")}`;
    }
    // A value of x with its unit, in the digits that axis and slack resolve.
    along(value, slack = 0) {
      const unit = (this.x_label.match(/\(([^)]*)\)$/) || ["", ""])[1];
      return `${known(value, Math.max(this.right - this.left, slack * SIDE))} ${unit}`.trim();
    }
    reading(y) {
      return this.is_log ? fixed(this.height(y), 0) : known(this.height(y), this.top - this.bottom);
    }
    // The sample of any curve that is nearest to x.
    snapped(x) {
      return closest(this.shown.map((curve) => curve.nearest(x)), x);
    }
    step(x, direction) {
      return closest(this.shown.map((curve) => curve.step(x, direction)), x);
    }
    // Points at the sample of a plane that is nearest to a place of the drawing.
    point_plane(right, down) {
      let best = null;
      const box = this.svg.getBoundingClientRect();
      for (const curve of this.shown) {
        curve.data.x.forEach((x, place) => {
          const y = curve.data.y[place];
          const far = Math.hypot(((x - right) * box.width) / SIDE, ((y - down) * box.height) / SIDE);
          if (!(far >= (best ? best.far : Infinity))) best = { curve, x, y, far };
        });
      }
      return best && this.show_plane(best);
    }
    show_plane({ curve, x, y }) {
      this.figure.classList.add("pointed");
      for (const other of this.curves) { other.value.textContent = ""; other.dot.hidden = true; }
      this.place(curve.dot, x, y);
      this.place(this.hair, x, 0);
      this.stamp.textContent = this.along(this.to_value(x));
      curve.value.textContent = this.reading(y);
      this.walked = { curve, x, y };
      const [, note] = this.notes.find(([at]) => at[0] === x && at[1] === y) || [];
      // A note stays until another one replaces it, so that it can be copied.
      if (note) for (const [, other] of this.notes) other.hidden = other !== note;
      return `${note ? note.textContent + ". " : ""}`
        + `${this.title}: ${curve.label} ${curve.value.textContent} ${this.unit} at ${this.stamp.textContent}`;
    }
    walk_plane(steps) {
      const curve = this.walked && this.walked.curve.is_shown ? this.walked.curve : this.shown[0];
      if (!curve) return "";
      const { x, y } = curve.data;
      const from = this.walked ? x.findIndex((right, place) => right === this.walked.x && y[place] === this.walked.y) : 0;
      let place = clamped(from + steps, 0, x.length - 1);
      if (Number.isNaN(x[place])) place += Math.sign(steps);
      return this.show_plane({ curve, x: x[place], y: y[place] });
    }
  }

  // Filter of the tables that list runs, by name and outcome.
  const rows = [...document.querySelectorAll(".listed tbody tr")];
  if (rows.length > 1) {
    const form = document.createElement("form");
    form.className = "filter";
    document.querySelector(".listed").parentNode.before(form);
    const label = make("label", "", form);
    label.textContent = "Filter ";
    const text = make("input", "", label);
    text.type = "search";
    const outcomes = [...new Set(rows.map((row) => row.dataset.outcome))].map((outcome) => {
      const label = make("label", "", form);
      const box = make("input", "", label);
      box.type = "checkbox";
      box.checked = true;
      box.value = outcome;
      label.append(` ${outcome}`);
      return box;
    });
    const count = make("output", "soft", form);
    const words = rows.map((row) => [...row.querySelectorAll(".name, .words")].map((cell) => cell.textContent).join(" ").toLowerCase());
    const apply = () => {
      const wanted = text.value.toLowerCase().split(/\s+/);
      const chosen = outcomes.filter((box) => box.checked).map((box) => box.value);
      rows.forEach((row, number) => {
        row.hidden = !chosen.includes(row.dataset.outcome) || !wanted.every((word) => words[number].includes(word));
      });
      for (const table of document.querySelectorAll(".listed")) {
        table.parentNode.hidden = ![...table.tBodies[0].rows].some((row) => !row.hidden);
      }
      const first = rows[0].parentNode;
      const shown = new Set([...first.rows].filter((row) => !row.hidden).map((row) => row.dataset.run));
      for (const plot of document.querySelectorAll("[data-runs]")) {
        plot.hidden = !plot.dataset.runs.split(" ").some((run) => shown.has(run));
      }
      for (const part of document.querySelectorAll(".of-listed")) {
        part.hidden = [...part.querySelectorAll(".wide, [data-runs]")].every((one) => one.hidden);
      }
      count.textContent = shown.size ? `${shown.size} of ${first.rows.length} runs` : "No run is left: change the filter.";
    };
    form.addEventListener("input", apply);
    form.addEventListener("submit", (event) => event.preventDefault());
    apply();
  }

  const plots = [...document.querySelectorAll("figure.plot")].map((figure) => new Plot(figure));
  if (!plots.length) return;
  // Plots whose horizontal axes are called the same share one.
  const group = (plot) => plots.filter((other) => other === plot || (!other.is_plane && other.x_label === plot.x_label));
  const live = make("div", "unseen", document.body);
  live.setAttribute("aria-live", "polite");
  const zoom = (plot, stretch) => group(plot).forEach((other) => other.look(stretch));
  let pointed = null;
  let asked = 0;
  const point = (plot, value) => {
    pointed = value;
    cancelAnimationFrame(asked);
    asked = requestAnimationFrame(() => group(plot).forEach((other) => {
      if (value === null || other === plot || other.is_in_window()) other.point(value, (plot.right - plot.left) / SIDE);
    }));
  };
  const scaled = (plot, factor, middle) => {
    const [from, until] = plot.stretch;
    const bounds = [plot.left, plot.right];
    const stretch = [middle - (middle - from) * factor, middle + (until - middle) * factor];
    const is_whole = stretch[0] <= bounds[0] && stretch[1] >= bounds[1];
    if (stretch[1] - stretch[0] > (bounds[1] - bounds[0]) * 1e-4) zoom(plot, is_whole ? null : stretch);
  };

  for (const plot of plots) {
    const axes = plot.axes;
    // Place of an event in the drawing's units.
    const unit = (event) => {
      const box = plot.svg.getBoundingClientRect(), [left, up, width, height] = plot.view;
      return [left + clamped((event.clientX - box.left) / box.width, 0, 1) * width, up + ((event.clientY - box.top) / box.height) * height];
    };
    let start = null;
    // Marks the stretch from the start to an event, in the drawing's units. Returns it if it is wide enough to be meant.
    const select = (event) => {
      const [left, , width] = plot.view, ends = [start, unit(event)[0]].sort((a, b) => a - b);
      plot.selection.style.left = `${((ends[0] - left) / width) * 100}%`;
      plot.selection.style.width = `${((ends[1] - ends[0]) / width) * 100}%`;
      return (ends[1] - ends[0]) * plot.svg.clientWidth > 4 * width && ends;
    };
    axes.addEventListener("pointerdown", (event) => {
      if (event.button || plot.is_plane || event.pointerType === "touch") return;
      [start] = unit(event);
      select(event);
      axes.setPointerCapture(event.pointerId);
    });
    axes.addEventListener("pointermove", (event) => {
      const [right, down] = unit(event);
      if (plot.is_plane) return void plot.point_plane(right, down);
      if (start !== null) plot.figure.classList.toggle("selecting", Boolean(select(event)));
      const x = plot.snapped(right);
      if (x !== undefined) point(plot, plot.to_value(x));
    });
    axes.addEventListener("pointerup", (event) => {
      if (start === null) return;
      const ends = select(event);
      start = null;
      plot.figure.classList.remove("selecting");
      if (ends) zoom(plot, ends.map((x) => plot.to_value(x)));
    });
    axes.addEventListener("pointercancel", () => { start = null; plot.figure.classList.remove("selecting"); });
    axes.addEventListener("pointerleave", () => point(plot, null));
    axes.addEventListener("dblclick", () => zoom(plot, null));
    plot.reset.addEventListener("click", () => { zoom(plot, null); axes.focus(); });
    // Without a key or the focus the wheel scrolls the page.
    axes.addEventListener("wheel", (event) => {
      if (plot.is_plane || !(event.ctrlKey || document.activeElement === axes)) return;
      event.preventDefault();
      scaled(plot, event.deltaY > 0 ? 1.25 : 0.8, plot.to_value(unit(event)[0]));
    }, { passive: false });
    axes.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      const middle = pointed ?? (plot.stretch[0] + plot.stretch[1]) / 2;
      if (steps && plot.is_plane) live.textContent = plot.walk_plane(steps * (event.shiftKey ? 10 : 1));
      else if (plot.is_plane) return;
      else if (steps || event.key === "Home" || event.key === "End") {
        let x = { Home: plot.view[0], End: plot.view[0] + plot.view[2] }[event.key];
        x = x === undefined ? plot.to_unit(middle) : plot.snapped(x);
        for (let left = event.shiftKey ? 10 : 1; steps && left; left--) x = plot.step(x, steps) ?? x;
        const value = plot.to_value(x);
        const [from, until] = plot.stretch;
        if (value < from || value > until) zoom(plot, [value - (until - from) / 2, value + (until - from) / 2]);
        live.textContent = plot.point(value);
        point(plot, value);
      } else if (event.key === "+") scaled(plot, 0.5, middle);
      else if (event.key === "-") scaled(plot, 2, middle);
      else if (event.key === "Escape") zoom(plot, null);
      else return;
      event.preventDefault();
    });
  }
  const hint = make("p", "soft hint", plots[0].figure);
  hint.textContent = "Drag: zoom. Wheel in a plot that was clicked, or with Ctrl: zoom. Double click or Escape: whole. "
    + "A name: its curve off and on. \u2248 is the nearest sample that the page holds.";
})();
