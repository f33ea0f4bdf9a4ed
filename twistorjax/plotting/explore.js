// Sliders, the deformed mechanism, and a curve. The model has what is constant (`page`),
// the positions of the sliders (`request`), and what is shown for them (`state`). In a
// notebook, Python answers requests; on a page without Python, `tableOf` does.

const SVG = "http://www.w3.org/2000/svg";
const STYLE = `
.tj-explorer { display: flex; flex-wrap: wrap; gap: 1rem; font-size: 14px; }
.tj-explorer > div { flex: 1 1 20rem; min-width: 0; }
.tj-explorer label { display: grid; grid-template-columns: 8rem 1fr 7rem; gap: 0.5rem; }
.tj-explorer svg { width: 100%; height: auto; display: block; overflow: visible; }
.tj-explorer text { fill: currentColor; font-size: 12px; }
.tj-explorer p { color: #d55e00; min-height: 1.5em; margin: 0; }
`;

function render({ model, el }) {
  const page = model.get("page");
  const root = element("div", { class: "tj-explorer" }, el);
  element("style", {}, root).textContent = STYLE;
  const left = element("div", {}, root);
  const right = element("div", {}, root);

  const values = page.sliders.map((slider) => slider.value);
  const shown = { over: page.sliders.length - 1, curve: 0 };
  let number = 0;
  let asked = null; // the time of the request that has no answer yet
  let again = false;

  const drawing = element("svg", { viewBox: viewBox(page.box), role: "img" }, left, SVG);
  drawing.setAttribute("aria-label", "the deformed mechanism");
  const parts = page.shapes.map(([kind]) => element("path", look(kind, page), drawing, SVG));
  addScale(drawing, page);
  const message = element("p", { role: "status" }, left);
  page.sliders.forEach((slider, k) => addSlider(slider, k));
  if (page.sliders.length > 1) {
    addChoice("curve over", page.sliders.map((s) => s.name), "over");
  }
  if (page.curves.length > 1) addChoice("curve of", page.curves, "curve");
  const chart = page.curves.length
    ? element("svg", { viewBox: "0 0 400 300", role: "img" }, right, SVG)
    : null;

  function addSlider(slider, k) {
    const label = element("label", {}, left);
    element("span", {}, label).textContent = slider.name;
    // On a page without Python, a slider has some positions, which it counts.
    const { lower, upper, value, positions } = slider;
    const range = positions
      ? { min: 0, max: positions.length - 1, step: 1, value: positions.indexOf(value) }
      : { min: lower, max: upper, step: (upper - lower) / 1000, value };
    const input = element("input", { type: "range", ...range }, label);
    const output = element("output", {}, label);
    const follow = () => {
      values[k] = positions ? positions[Number(input.value)] : Number(input.value);
      output.textContent = `${rounded(values[k])} ${slider.unit}`;
    };
    follow();
    input.addEventListener("input", () => {
      follow();
      ask();
    });
  }

  function addChoice(text, names, field) {
    const label = element("label", {}, right);
    element("span", {}, label).textContent = text;
    const select = element("select", {}, label);
    names.forEach((name, k) => {
      element("option", { value: k }, select).textContent = name;
    });
    select.value = shown[field];
    select.addEventListener("change", () => {
      shown[field] = Number(select.value);
      ask();
    });
  }

  // One request is under way at a time; the newest positions follow it.
  function ask() {
    if (asked !== null) {
      again = true;
      return;
    }
    asked = performance.now();
    number += 1;
    model.set("request", { number, values: [...values], over: shown.over });
    model.save_changes();
  }

  function update() {
    const state = model.get("state");
    if (state.number !== number) return;
    message.textContent = state.message && `No equilibrium: ${state.message}`;
    drawing.setAttribute("opacity", state.points.length ? 1 : 0.3);
    if (state.points.length) drawParts(parts, page.shapes, state.points);
    if (chart) drawChart(chart, page, shown, state, values);
    const start = asked;
    asked = null;
    requestAnimationFrame(() => performance.measure("twistorjax redraw", { start }));
    if (again) {
      again = false;
      ask();
    }
  }

  model.on("change:state", update);
  ask();
}

export default { render };

// Answer requests from a table of states: all combinations of positions of the sliders.
function tableOf(data) {
  const { page, outputs, messages } = data;
  const bytes = Uint8Array.from(atob(data.points), (c) => c.charCodeAt(0));
  const coordinates = new Int16Array(bytes.buffer);
  const size = 2 * page.shapes.reduce((sum, [, count]) => sum + count, 0);
  let drawn = 0;
  const starts = messages.map((text) => (text ? -1 : size * drawn++));
  const store = { page };
  let listener = () => {};

  function answer({ number, values, over }) {
    const { positions } = page.sliders[over];
    const at = values.map((value, k) => page.sliders[k].positions.indexOf(value));
    const row = (levels) =>
      levels.reduce((sum, level) => sum * positions.length + level, 0);
    const here = row(at);
    const points = starts[here] < 0 ? [] : coordinates.slice(starts[here], starts[here] + size);
    return {
      number,
      points: Array.from(points, (x, k) => data.origin[k % 2] + data.scale * x),
      message: messages[here],
      outputs: outputs[here],
      at: positions,
      along: positions.map((_, k) => outputs[row(at.with(over, k))]),
    };
  }

  return {
    get: (name) => store[name],
    set: (name, value) => {
      store[name] = value;
    },
    on: (_, callback) => {
      listener = callback;
    },
    save_changes: () => {
      store.state = answer(store.request);
      listener();
    },
  };
}

function element(tag, attributes, parent, namespace) {
  const made = namespace
    ? document.createElementNS(namespace, tag)
    : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  parent.append(made);
  return made;
}

function rounded(value) {
  return String(Number(value.toPrecision(4)));
}

// The y axis of an SVG points down.
function viewBox([left, bottom, right, top]) {
  const margin = 0.05 * Math.max(right - left, top - bottom);
  const [width, height] = [right - left + 2 * margin, top - bottom + 3 * margin];
  return [left - margin, -top - margin, width, height].join(" ");
}

function look(kind, page) {
  const color = page.colors[kind];
  const line = { fill: "none", "vector-effect": "non-scaling-stroke" };
  if (kind === "reference") {
    return { ...line, stroke: "currentColor", "stroke-dasharray": "2 3", opacity: 0.6 };
  }
  if (kind === "hinge") return { ...line, fill: color, stroke: color };
  if (kind === "body" || kind === "fixed") return { ...line, fill: color, stroke: "#404040" };
  return { ...line, stroke: color, "stroke-width": 3, "stroke-linecap": "round" };
}

function drawParts(parts, shapes, points) {
  let start = 0;
  shapes.forEach(([kind, count], k) => {
    const corners = [];
    for (let i = start; i < start + 2 * count; i += 2) {
      corners.push(`${points[i]} ${-points[i + 1]}`);
    }
    start += 2 * count;
    const end = kind === "line" || kind === "spring" ? "" : "Z";
    parts[k].setAttribute("d", `M${corners.join("L")}${end}`);
  });
}

// A bar of a round length below the mechanism
function addScale(drawing, page) {
  const [left, bottom, right, top] = page.box;
  const size = Math.max(right - left, top - bottom);
  const [length] = ticks(0, size / 3).slice(-1);
  const y = -bottom + 0.06 * size;
  const bar = { d: `M${left} ${y}h${length}`, stroke: "currentColor", "stroke-width": 2 };
  element("path", { ...bar, "vector-effect": "non-scaling-stroke" }, drawing, SVG);
  const place = { x: left + length + 0.01 * size, y: y + 0.01 * size };
  const text = element("text", place, drawing, SVG);
  text.style.fontSize = `${0.03 * size}px`;
  const factor = page.magnify === 1 ? "" : `; displacements magnified ${page.magnify} times`;
  text.textContent = `${length} ${page.unit}${factor}`;
}

// Round numbers between two bounds
function ticks(low, high) {
  const step = 10 ** Math.floor(Math.log10((high - low) / 5));
  const factor = [1, 2, 5, 10].find((k) => (high - low) / (k * step) <= 5);
  const width = factor * step;
  const found = [];
  for (let k = Math.ceil(low / width - 1e-9); k * width <= high * (1 + 1e-9); k += 1) {
    found.push(Number((k * width).toPrecision(10)));
  }
  return found;
}

function drawChart(chart, page, shown, state, values) {
  chart.replaceChildren();
  const slider = page.sliders[shown.over];
  const along = state.along.map((outputs) => outputs[shown.curve]);
  const here = state.outputs[shown.curve];
  const known = [...along, here].filter((y) => y !== null);
  if (!known.length) return;
  let [low, high] = [Math.min(...known), Math.max(...known)];
  const least = Math.max(1e-9 * Math.max(Math.abs(low), Math.abs(high)), 1e-30);
  if (high - low < least) [low, high] = [low - least, high + least];
  const margin = 0.05 * (high - low);
  [low, high] = [low - margin, high + margin];
  const [x0, x1, y0, y1] = [70, 390, 250, 15];
  const px = (x) => x0 + ((x - slider.lower) / (slider.upper - slider.lower)) * (x1 - x0);
  const py = (y) => y0 + ((y - low) / (high - low)) * (y1 - y0);
  const line = { fill: "none", stroke: "currentColor" };
  const write = (text, x, y, anchor, more = {}) => {
    const place = { x, y, "text-anchor": anchor, ...more };
    element("text", place, chart, SVG).textContent = text;
  };
  for (const x of ticks(slider.lower, slider.upper)) {
    element("path", { ...line, d: `M${px(x)} ${y0}V${y1}`, opacity: 0.15 }, chart, SVG);
    write(rounded(x), px(x), y0 + 16, "middle");
  }
  for (const y of ticks(low, high)) {
    element("path", { ...line, d: `M${x0} ${py(y)}H${x1}`, opacity: 0.15 }, chart, SVG);
    write(rounded(y), x0 - 6, py(y) + 4, "end");
  }
  element("path", { ...line, d: `M${x0} ${y1}V${y0}H${x1}` }, chart, SVG);
  const unit = slider.unit ? ` (${slider.unit})` : "";
  write(slider.name + unit, (x0 + x1) / 2, y0 + 36, "middle");
  const middle = (y0 + y1) / 2;
  const turned = { transform: `rotate(-90 14 ${middle})` };
  write(page.curves[shown.curve], 14, middle, "middle", turned);
  let d = "";
  along.forEach((y, k) => {
    if (y === null) return;
    const starts = k === 0 || along[k - 1] === null;
    d += `${starts ? "M" : "L"}${px(state.at[k])} ${py(y)}`;
  });
  element("path", { ...line, d, stroke: "#0072b2", "stroke-width": 2 }, chart, SVG);
  if (here !== null) {
    const place = { cx: px(values[shown.over]), cy: py(here), r: 5, fill: "#d55e00" };
    element("circle", place, chart, SVG);
    const side = place.cx > (x0 + x1) / 2 ? -1 : 1;
    const anchor = side < 0 ? "end" : "start";
    const above = place.cy > y1 + 30 ? -8 : 18;
    write(rounded(here), place.cx + 8 * side, place.cy + above, anchor, { "font-weight": "bold" });
  }
}
