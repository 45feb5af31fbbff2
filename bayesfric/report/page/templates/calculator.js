"use strict";
(() => {
  const place = document.querySelector(".ask");
  if (!place) return;
  const model = JSON.parse(place.dataset.model);
  const draws = Math.max(1, ...model.values.map((one) => (Array.isArray(one) ? one.length : 1)));

  // the law comes as statements in NumPy's functions, made of the model's own
  const operations = {
    add: (a, b) => a + b, subtract: (a, b) => a - b, multiply: (a, b) => a * b, divide: (a, b) => a / b,
    negative: (a) => -a, positive: (a) => a, absolute: Math.abs, sign: Math.sign, maximum: Math.max,
    minimum: Math.min, power: Math.pow, square: (a) => a * a, sqrt: Math.sqrt, exp: Math.exp,
    expm1: Math.expm1, log: Math.log, log1p: Math.log1p, sin: Math.sin, cos: Math.cos, tan: Math.tan,
    arctan: Math.atan, tanh: Math.tanh, greater: (a, b) => a > b, where: (test, yes, no) => (test ? yes : no),
  };
  const valueOf = (formula, state) => {
    if (typeof formula === "number") return formula;
    if (typeof formula === "string") return state[formula];
    return operations[formula[0]](...formula.slice(1).map((one) => valueOf(one, state)));
  };

  // one draw: torque at the motor, and what each group of terms makes of it
  const inverse = ({ position: q, speed: v, acceleration: a, load: push }, draw) => {
    const state = { q, v, a, s: Math.sign(v), push };
    model.values.forEach((told, k) => { state[`p${k}`] = typeof told === "number" ? told : told[draw]; });
    for (const [name, formula] of model.law) state[name] = valueOf(formula, state);
    return state;
  };

  const quantile = (sorted, share) => {
    const at = share * (sorted.length - 1), below = Math.floor(at);
    const above = Math.min(below + 1, sorted.length - 1);
    return sorted[below] + (at - below) * (sorted[above] - sorted[below]);
  };
  const spread = (values) => {
    const sorted = Float64Array.from(values).sort();
    return [0.5, 0.5 - model.level / 2, 0.5 + model.level / 2].map((share) => quantile(sorted, share));
  };
  const shown = ([middle, low, high]) => {
    const size = Math.max(Math.abs(middle), Math.abs(low), Math.abs(high));
    if (size === 0) return { middle: "0", band: "" };
    const width = Math.max((high - low) / 2, 1e-4 * size, 1e-12);
    const digits = Math.min(Math.max(1 - Math.floor(Math.log10(width)), 0), 9);
    const text = (x) => (Math.abs(x) < 0.5 * 10 ** -digits ? 0 : x).toFixed(digits).replace("-", "−");
    return { middle: text(middle), band: `[${text(low)}, ${text(high)}]` };
  };
  const keep = (node, found) => {
    [node.dataset.value, node.dataset.low, node.dataset.high] = found.map(String);
  };

  const inputs = new Map([...place.querySelectorAll("[data-input]")].map((one) => [one.dataset.input, one]));
  const sliders = new Map([...place.querySelectorAll("[data-slider]")].map((one) => [one.dataset.slider, one]));
  const answers = new Map([...place.querySelectorAll("[data-answer]")].map((one) => [one.dataset.answer, one]));
  const rows = new Map([...place.querySelectorAll("tr[data-group]")].map((one) => [one.dataset.group, one]));
  const told = place.querySelector(".told");
  const [length, effort] = [model.motion === "rotary" ? "rad" : "m", model.motor_motion === "rotary" ? "N m" : "N"];

  const say = (lines) => {
    told.replaceChildren(...lines.map((line) => Object.assign(document.createElement("li"), { textContent: line })));
    told.hidden = !lines.length;
    place.dataset.warnings = String(lines.length);
  };
  const nothing = (line) => {
    for (const node of [...answers.values(), ...rows.values()]) {
      delete node.dataset.value; delete node.dataset.low; delete node.dataset.high;
    }
    for (const node of answers.values()) node.textContent = "–";
    for (const row of rows.values()) for (const cell of [...row.cells].slice(1)) cell.replaceChildren();
    say([line]);
  };
  const never = (asked, weight) => {
    const { seen } = model, lines = [];
    const ends = ([low, high]) => `${low.toPrecision(3)} and ${high.toPrecision(3)}`.replaceAll("-", "−");
    const outside = (x, [low, high]) => x < low || x > high;
    const was = (what, range, unit) => `The data never were at this ${what}: they were between ${ends(range)} ${unit}.`;
    if (outside(asked.speed, seen.speed)) lines.push(was("speed", seen.speed, `${length}/s`));
    else if (Math.abs(asked.speed) < seen.slowest)
      lines.push(`The data never were this slow: nothing below ${seen.slowest.toPrecision(2)} ${length}/s was used.`);
    if (inputs.has("acceleration") && outside(asked.acceleration, seen.acceleration))
      lines.push(was("acceleration", seen.acceleration, `${length}/s²`));
    if (inputs.has("position") && outside(asked.position, seen.position))
      lines.push(was(model.motion === "rotary" ? "angle" : "position", seen.position, length));
    // a joint that carries nothing has seen no load at all; rounding is none
    const slack = 1e-6 * Math.max(...seen.load.map(Math.abs));
    if (outside(weight, [seen.load[0] - slack, seen.load[1] + slack]))
      lines.push(seen.load[0] === seen.load[1] ? "The data never saw a load." : was("load", seen.load, `${effort} at the motor, inertia of the load and all`));
    if (asked.load && model.open_scale)
      lines.push("How much of a load besides its own reaches the motor, these data leave open: prior and bounds make that band.");
    return lines;
  };

  const answer = () => {
    const asked = { speed: 0, acceleration: 0, position: 0, load: 0 };
    for (const [name, input] of inputs) {
      asked[name] = input.valueAsNumber;
      input.setAttribute("aria-invalid", String(!Number.isFinite(asked[name])));
      if (!Number.isFinite(asked[name])) return nothing(`Give a number for ${input.labels[0].textContent.trim()}.`);
    }
    const all_at = (speed) => Array.from({ length: draws }, (_, draw) => inverse({ ...asked, speed }, draw));
    if (asked.speed === 0) {
      // what it takes to move hardly at all, either way
      const ends = [-1e-12, 1e-12].map((speed) => spread(all_at(speed).map((one) => one.torque)));
      const [low, high] = ends.sort((one, other) => one[0] - other[0]).map((one) => shown(one).middle);
      const unit = effort === "N" ? "N" : "N\u00a0m";
      return nothing(`At rest friction has no one value: with anything from ${low} to ${high} ${unit} the motor holds the joint still, beyond them it breaks away (medians). Choose a speed.`);
    }
    const found = all_at(asked.speed);
    for (const [name, node] of answers) {
      const all = spread(found.map((one) => one[name]));
      keep(node, all);
      const { middle, band } = shown(all);
      node.replaceChildren(Object.assign(document.createElement("b"), { textContent: middle }), ` ${band}`.replaceAll(", ", ",\u00a0"));
    }
    const all = new Map([...rows.keys()].map((name) => [name, spread(found.map((one) => one[name]))]));
    const size = [...all.values()].reduce((sum, [middle]) => sum + Math.abs(middle), 0);
    for (const [name, row] of rows) {
      const one = all.get(name), { middle, band } = shown(one);
      const share = size ? (100 * one[0]) / size : 0;
      keep(row, one);
      const ends = Object.assign(document.createElement("span"), { className: "meaning", textContent: band });
      row.cells[1].replaceChildren(middle, ends);
      const bar = Object.assign(document.createElement("span"), { className: share < 0 ? "bar minus" : "bar" });
      bar.style.width = `${(Math.abs(share) * 0.5).toFixed(1)}%`;
      row.cells[2].replaceChildren(bar, ` ${share.toFixed(0).replace("-", "−")} %`);
    }
    say(never(asked, spread(found.map((one) => one.weight))[0]));
  };

  // what is read out waits until one stops dragging
  let waiting = 0;
  const soon = () => { clearTimeout(waiting); waiting = setTimeout(answer, 60); };
  for (const [name, input] of inputs) {
    const slider = sliders.get(name);
    input.addEventListener("input", () => { if (input.value) slider.value = input.value; soon(); });
    input.addEventListener("change", answer);
    slider.addEventListener("input", () => { input.value = slider.value; soon(); });
  }
  answer();
})();
