/* A time line that a person drags, and what the samples prove while it moves. No dependencies, no requests of its own:
   `mount(element, ask)` draws into an element and asks through the one function that it is given. */

const SVG = "http://www.w3.org/2000/svg";
const COLOUR = { measured: "#2b6398", proven: "#20793e", attained: "#9b6205", allowed: "#767676", failed: "#910d11" };
const LEFT = 125, RIGHT = 14, ROW = 46, CHART = 150;
const STYLE = `
.sd { font: 15px/1.45 system-ui, "Helvetica Neue", Arial, sans-serif; color: #1b1b1b; background: #fff; max-width: 900px; padding: 12px; }
.sd h1 { font-size: 20px; margin: 0 0 2px; } .sd p { margin: 4px 0; }
.sd svg { width: 100%; height: auto; display: block; user-select: none; } .sd .line { touch-action: pan-y; }
.sd text { font: 12px system-ui, Arial, sans-serif; fill: #1b1b1b; } .sd .soft { fill: #595959; }
.sd button { font: inherit; margin: 6px 6px 6px 0; padding: 5px 14px; border: 1px solid #1f5fa8; border-radius: 6px; background: #fff; color: #1f5fa8; cursor: pointer; }
.sd button:hover, .sd button:focus-visible { background: #1f5fa8; color: #fff; } .sd button:disabled { opacity: 0.5; cursor: wait; }
.sd .mark { cursor: grab; } .sd .mark:focus { outline: none; } .sd .mark:focus circle { stroke: #000; stroke-width: 3; }
.sd .messages { color: ${COLOUR.failed}; min-height: 1.5em; } .sd .said { min-height: 1.5em; white-space: pre-wrap; }
.sd .repair button { margin: 0 0 0 8px; padding: 1px 10px; } .sd .unknown { color: ${COLOUR.failed}; white-space: pre-wrap; } .sd .after { display: inline-block; margin-right: 14px; font-size: 13px; }
.sd .stale { opacity: 0.3; } .sd svg:empty { display: none; }
.sd .hint { color: #595959; font-size: 13px; }`;

/* Four digits, of large numbers all before the point: a day of 86400 s has its samples at whole seconds.
   Of a bound, `up` says which way: an upper one is rounded up (true), a lower one down (false). */
function short(x, up) {
  if (x === null || x === undefined) return "–";
  const digits = Math.min(Math.max(4, Math.ceil(Math.log10(Math.abs(x) + 1))), 15);
  if (!Number.isFinite(x) || x === 0) return String(x);
  const nearest = Number(Number(x).toPrecision(digits)), unit = 10 ** (Math.floor(Math.log10(Math.abs(x))) + 1 - digits);
  const away = up === undefined ? 0 : Math.sign(x - nearest);
  return String(Number((nearest + (away === (up ? 1 : -1) ? away * unit : 0)).toPrecision(digits)));
}

function node(kind, attributes, parent, text) {
  const made = document.createElementNS(SVG, kind);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  if (parent) parent.append(made);
  return made;
}

function html(kind, attributes, parent, text) {
  const made = document.createElement(kind);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  if (parent) parent.append(made);
  return made;
}

function ticks(from, to, steps = [1, 2, 2.5, 5, 10]) {
  const rough = (to - from) / 6, base = 10 ** Math.floor(Math.log10(rough));
  const step = steps.map((k) => k * base).find((k) => k >= rough);
  const found = [];
  for (let k = Math.ceil(from / step - 1e-9); k * step <= to + 1e-9 * step; k++) found.push(k * step);
  return found;
}

export async function mount(element, ask) {
  const opened = await ask({ ask: "open" });
  const root = html("div", { class: "sd" }, element);
  // as many units as there are pixels, so that text keeps its size on a telephone
  const WIDE = Math.round(Math.min(Math.max((element.clientWidth || 884) - 24, 340), 860));
  const narrow = WIDE < 600;
  if (opened.error) return html("p", { class: "messages" }, root, opened.error);
  html("style", {}, root, STYLE);
  html("h1", {}, root, opened.name);
  if (opened.words) html("p", { class: "words" }, root, opened.words);
  const line = node("svg", { class: "line", role: "group", "aria-label": "samples of one period" }, root);
  const messages = html("p", { class: "messages", role: "status", "aria-live": "polite" }, root);
  const repair = html("p", { class: "repair", role: "status" }, root);
  const chart = node("svg", { class: "sigma", role: "img", "aria-label": "sigma over the window's position" }, root);
  const left = html("p", { class: "hint left", role: "status" }, root);
  const buttons = html("div", {}, root);
  const said = html("p", { class: "said", role: "status", "aria-live": "polite" }, root);
  const unknown = html("p", { class: "unknown", role: "status" }, root);
  const errors = opened.bounds ? node("svg", { class: "accuracy", role: "img", "aria-label": "least error that can be guaranteed" }, root) : null;
  const set = opened.projection ? html("div", { class: "projection" }, root) : null;
  if (set && errors) root.insertBefore(set, errors);
  html("p", { class: "hint" }, root, "Drag a sample. Click a row to add one, double-click a sample (or press Delete) to take it away; arrow keys move it; with Shift one sensor moves alone.");

  const { period, sensors, unit, per_unit } = opened;
  // times are the plant's; axes and words count in `unit`, of which the plant's is `per_unit`
  const clock = (t) => `${short(t * per_unit)} ${unit}`;
  function timeTicks(svg, from, to, x, y) {
    for (const t of ticks(from * per_unit, to * per_unit, [1, 2, 3, 6, 10]))
      node("text", { x: x(t / per_unit), y, "text-anchor": "middle", class: "soft" }, svg, t === 0 ? "0" : short(t));
  }
  let marks = opened.marks;
  const at = (t) => LEFT + ((WIDE - LEFT - RIGHT) * t) / period;
  const time = (event) => {
    const box = line.getBoundingClientRect();
    const t = ((((event.clientX - box.left) * WIDE) / box.width - LEFT) / (WIDE - LEFT - RIGHT)) * period;
    return Math.min(Math.max(t, 0), period * (1 - 1e-9));
  };
  const row = (event) => {
    const box = line.getBoundingClientRect();
    const height = sensors.length * ROW + 44;
    return Math.min(Math.max(Math.floor((((event.clientY - box.top) * height) / box.height - 8) / ROW), 0), sensors.length - 1);
  };

  /* The newest positions are asked for, and one question is under way. */
  let busy = false, newest = null;
  const pressed = [];
  function send(question, then) {
    if (question.button) pressed.push([question, then]);
    else newest = [question, then];
    next();
  }
  async function next() {
    const [question, then] = busy ? [] : pressed.shift() || newest || [];
    if (!question) return;
    if (newest && newest[0] === question) newest = null;
    busy = true;
    const answer = await ask(question).catch((error) => ({ error: `No answer: ${error.message || error}` }));
    busy = false;
    then(answer);
    next();
  }

  function frame(svg, y, height, top, label) {
    node("line", { x1: LEFT, x2: WIDE - RIGHT, y1: y + height, y2: y + height, stroke: "#888" }, svg);
    if (label) node("text", { x: LEFT - 48, y: y + 14, "text-anchor": "end" }, svg, label);
    for (const value of ticks(0, top).slice(0, 7)) {
      const h = y + height - (height * value) / top;
      node("line", { x1: LEFT, x2: WIDE - RIGHT, y1: h, y2: h, stroke: "#e4e4e4" }, svg);
      node("text", { x: LEFT - 8, y: h + 4, "text-anchor": "end", class: "soft" }, svg, short(value));
    }
  }

  function drawLine() {
    const focused = line.querySelector(".mark:focus");
    const kept = focused ? focused.dataset.key : null;
    const height = sensors.length * ROW + 44;
    line.setAttribute("viewBox", `0 0 ${WIDE} ${height}`);
    line.replaceChildren();
    sensors.forEach((sensor, k) => {
      const y = 8 + k * ROW;
      node("rect", { x: LEFT, y, width: WIDE - LEFT - RIGHT, height: ROW - 6, fill: "#f3f6fa", class: "row" }, line);
      for (const [a, b] of [...opened.forbidden, ...sensor.closed])
        node("rect", { x: at(a), y, width: Math.max(at(b) - at(a), 0), height: ROW - 6, fill: "#c9c9c9" }, line);
      node("text", { x: LEFT - 8, y: y + ROW / 2, "text-anchor": "end" }, line, sensor.name);
    });
    timeTicks(line, 0, period, at, height - 22);
    node("text", { x: WIDE - RIGHT, y: height - 5, "text-anchor": "end", class: "soft" }, line, `time in the period [${unit}]`);
    shapes.clear();
    marks.forEach((mark, m) => {
      shapes.set(m, []);
      mark.on.forEach((on, k) => {
        if (!on) return;
        const y = 8 + k * ROW;
        const made = node("g", { class: "mark", tabindex: 0, role: "slider", "aria-label": `${sensors[k].name} at`, "data-key": `${m}-${k}` }, line);
        const stem = node("line", { y1: y, y2: y + ROW - 6, "stroke-width": 3 }, made);
        const head = node("circle", { cy: y + ROW / 2 - 3, r: 9, stroke: "#fff", "stroke-width": 2 }, made);
        shapes.get(m).push({ k, made, stem, head, title: node("title", {}, made, "") });
        made.addEventListener("pointerdown", (event) => grab(event, m, k));
        made.addEventListener("dblclick", () => remove(m, k));
        made.addEventListener("keydown", (event) => key(event, m, k));
      });
      place(m);
    });
    if (kept) line.querySelector(`[data-key="${kept}"]`)?.focus();
  }

  /* A drag moves one mark, sixty times a second: nothing else of the time line is drawn anew. */
  const shapes = new Map();
  function place(m) {
    const { t } = marks[m], x = at(t);
    for (const { k, made, stem, head, title } of shapes.get(m)) {
      const shut = [...opened.forbidden, ...sensors[k].closed].some(([a, b]) => a <= t && t < b);
      const colour = shut ? COLOUR.failed : COLOUR.measured;
      for (const [name, value] of [["x1", x], ["x2", x], ["stroke", colour]]) stem.setAttribute(name, value);
      for (const [name, value] of [["cx", x], ["fill", colour]]) head.setAttribute(name, value);
      made.setAttribute("aria-valuenow", short(t * per_unit));
      made.setAttribute("aria-valuetext", clock(t));
      title.textContent = `${sensors[k].name} at ${clock(t)}`;
    }
  }

  function single(m, k) {
    if (marks[m].on.filter(Boolean).length === 1) return m;
    marks[m].on[k] = false;
    marks.push({ t: marks[m].t, on: sensors.map((_, j) => j === k) });
    return marks.length - 1;
  }

  let dragged = false;
  function grab(event, m, k) {
    event.preventDefault();
    const own = event.shiftKey ? single(m, k) : m;
    if (own !== m) drawLine();
    const move = (e) => { dragged = true; marks[own].t = time(e); live(); place(own); };
    const drop = () => {
      window.removeEventListener("pointermove", move);
      for (const end of ["pointerup", "pointercancel"]) window.removeEventListener(end, drop);
      if (dragged) settled();
      setTimeout(() => (dragged = false), 0);
    };
    window.addEventListener("pointermove", move);
    for (const end of ["pointerup", "pointercancel"]) window.addEventListener(end, drop);
  }

  function remove(m, k) {
    marks[m].on[k] = false;
    marks = marks.filter((mark) => mark.on.some(Boolean));
    drawLine();
    settled();
  }

  function key(event, m, k) {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (step) marks[m].t = (((marks[m].t + (step * period) / 200) % period) + period) % period;
    else if (event.key === "Delete" || event.key === "Backspace") return remove(m, k);
    else return undefined;
    event.preventDefault();
    drawLine();
    return settled();
  }

  line.addEventListener("click", (event) => {
    if (dragged || !event.target.classList.contains("row")) return;
    const k = row(event);
    marks.push({ t: time(event), on: sensors.map((_, j) => j === k) });
    drawLine();
    settled();
  });

  function drawSigma(answer) {
    messages.textContent = answer.error || answer.messages.join(" ");
    repair.replaceChildren();
    chart.replaceChildren();
    left.textContent = (!answer.error && answer.left && answer.left.said) || "";
    chart.setAttribute("viewBox", `0 0 ${WIDE} ${CHART + (narrow ? 66 : 50)}`);
    if (answer.error || !answer.t.length) return;
    const highest = Math.max(...answer.sigma), top = highest > 0 ? 1.15 * highest : 1, from = answer.t[0], to = answer.t[answer.t.length - 1];
    const x = (t) => LEFT + ((WIDE - LEFT - RIGHT) * (t - from)) / (to - from || 1), y = (s) => 10 + CHART - (CHART * s) / top;
    frame(chart, 10, CHART, top, answer.scaled ? "scaled sigma" : "sigma");
    let path = "";
    answer.t.forEach((t, i) => (path += `${i && answer.piece[i] === answer.piece[i - 1] ? "L" : "M"}${x(t).toFixed(2)} ${y(answer.sigma[i]).toFixed(2)}`));
    node("path", { d: path, fill: "none", stroke: COLOUR.measured, "stroke-width": 2, class: "curve" }, chart);
    node("line", { x1: LEFT, x2: WIDE - RIGHT, y1: y(answer.lower), y2: y(answer.lower), stroke: COLOUR.proven, "stroke-width": 2, "stroke-dasharray": "7 4" }, chart);
    if (answer.left) {
      const lines = [[answer.left.late, "7 3 2 3", "late or early"], [answer.left.lost, "2 3", "one lost"]];
      for (const [value, dash, words] of lines.filter(([value]) => value !== null)) {
        const line = node("line", { x1: LEFT, x2: WIDE - RIGHT, y1: y(value), y2: y(value), stroke: COLOUR.proven, "stroke-dasharray": dash, class: "left" }, chart);
        node("title", {}, line, `${words}: sigma ≥ ${short(value, false)}`);
      }
    }
    node("circle", { cx: x(Math.min(Math.max(answer.worst, from), to)), cy: y(answer.upper), r: 5, fill: "#fff", stroke: COLOUR.attained, "stroke-width": 2 }, chart);
    timeTicks(chart, from, to, x, CHART + 26);
    node("text", { x: narrow ? 2 : LEFT, y: CHART + 44, class: "lower" }, chart, `proven, windows of ${clock(opened.window)}${answer.late ? `, samples ${answer.late}` : ""}: sigma ≥ ${short(answer.lower, false)}`);
    node("text", { x: WIDE - RIGHT, y: CHART + (narrow ? 60 : 44), "text-anchor": "end", class: "soft" }, chart, `end of the window [${unit}]`);
  }

  function drawAccuracy(answer) {
    errors.replaceChildren();
    errors.classList.remove("stale");
    unknown.textContent = answer.error ? `No error can be guaranteed: ${answer.error}` : answer.messages.join("\n");
    if (answer.error) return;
    const one = 90;
    errors.setAttribute("viewBox", `0 0 ${WIDE} ${opened.states.length * (one + 26) + 42}`);
    // over one period from its beginning, so that each edge stands below its sample
    const cells = opened.states.map((_, k) => {
      const found = [];
      (answer.upper[k] || []).forEach((s, i) => {
        const a = answer.edges[i] % period, b = a + answer.edges[i + 1] - answer.edges[i];
        found.push([a, Math.min(b, period), s]);
        if (b > period * (1 + 1e-12)) found.push([0, b - period, s]);
      });
      return found.sort((one, two) => one[0] - two[0]);
    });
    opened.states.forEach((state, k) => {
      const y0 = 20 + k * (one + 26), upper = answer.upper[k];
      node("text", { x: narrow ? 2 : LEFT, y: y0 - 4 }, errors, upper ? `${state}: guaranteed within ${short(answer.worst[k], true)}` : `${state}: no bound holds at all times`);
      if (!upper) return;
      const wanted = opened.tolerance ? opened.tolerance[k] : 0, top = 1.15 * Math.max(...upper, wanted);
      const y = (s) => y0 + one - (one * s) / top;
      frame(errors, y0, one, top, "");
      let path = `M${at(0)} ${y(0)}`;
      for (const [a, b, s] of cells[k]) path += `L${at(a).toFixed(2)} ${y(s).toFixed(2)}L${at(b).toFixed(2)} ${y(s).toFixed(2)}`;
      const good = !wanted || Math.max(...upper) <= wanted;
      node("path", { d: `${path}L${at(period)} ${y(0)}Z`, fill: good ? COLOUR.proven : COLOUR.failed, "fill-opacity": 0.25, stroke: good ? COLOUR.proven : COLOUR.failed }, errors);
      if (wanted) node("line", { x1: LEFT, x2: WIDE - RIGHT, y1: y(wanted), y2: y(wanted), stroke: "#000", "stroke-dasharray": "3 3" }, errors);
    });
    const foot = opened.states.length * (one + 26);
    timeTicks(errors, 0, period, at, foot + 8);
    node("text", { x: WIDE - RIGHT, y: foot + 25, "text-anchor": "end", class: "soft" }, errors, `time in the period [${unit}]`);
  }

  /* What the first sample, the first two, ... leave possible: one polygon in the next, the last one filled. */
  const SHADES = ["#767676", "#6929c4", "#222222"]; // none says how sure anything is; dashed from the fourth on
  function drawProjection(answer) {
    set.replaceChildren();
    set.classList.remove("stale");
    if (answer.error) return html("p", { class: "messages" }, set, answer.error);
    const seen = answer.steps.filter((step) => step.corners.length);
    html("p", {}, set, seen.length ? "What the samples leave possible at the end of the period, one after the other:" : "So few samples leave everything possible.");
    if (!seen.length) return undefined;
    const tall = Math.min(WIDE * 0.55, 360), points = seen.flatMap((step) => step.corners);
    const [a, b] = [0, 1].map((j) => 1.1 * Math.max(...points.map((p) => Math.abs(p[j]))));
    const x = (p) => LEFT + ((WIDE - LEFT - RIGHT) * (p + a)) / (2 * a), y = (p) => 8 + (tall * (b - p)) / (2 * b);
    const chart = node("svg", { viewBox: `0 0 ${WIDE} ${tall + 52}`, role: "img", "aria-label": `${answer.names.join(" and ")} that the samples leave possible` }, set);
    for (const v of ticks(-a, a)) node("text", { x: x(v), y: tall + 26, "text-anchor": "middle", class: "soft" }, chart, Math.abs(v) < 1e-9 * a ? "0" : short(v));
    for (const v of ticks(-b, b)) node("text", { x: LEFT - 8, y: y(v) + 4, "text-anchor": "end", class: "soft" }, chart, Math.abs(v) < 1e-9 * b ? "0" : short(v));
    node("rect", { x: LEFT, y: 8, width: WIDE - LEFT - RIGHT, height: tall, fill: "none", stroke: "#888" }, chart);
    node("text", { x: WIDE - RIGHT, y: tall + 44, "text-anchor": "end", class: "soft" }, chart, `error of ${answer.names[0]}`);
    node("text", { x: LEFT + 6, y: 24, class: "soft" }, chart, `error of ${answer.names[1]}`);
    seen.forEach((step, k) => {
      const colour = SHADES[(step.after - 1) % SHADES.length], last = k === seen.length - 1;
      node("polygon", { points: step.corners.map((p) => `${x(p[0]).toFixed(1)},${y(p[1]).toFixed(1)}`).join(" "), fill: colour, "fill-opacity": last ? 0.35 : 0.08, stroke: colour, "stroke-width": 2, "stroke-dasharray": step.after > SHADES.length ? "5 3" : "none", class: "set" }, chart);
      html("span", { class: "after", style: `color: ${colour}` }, set, `after ${step.after}: area ${short(step.area)}`);
    });
    return undefined;
  }

  function drawRepair(answer) {
    repair.replaceChildren();
    if (answer.error) return;
    html("span", {}, repair, answer.said);
    if (answer.to === undefined) return;
    const button = html("button", { type: "button", class: "move" }, repair, "Move it");
    button.addEventListener("click", () => {
      const mark = marks.find((each) => Math.abs(each.t - answer.at) <= 1e-9 * period);
      if (mark) mark.t = answer.to;
      drawLine();
      settled();
    });
  }

  /* What belongs to earlier places of the marks is pale until it is answered anew. */
  function stale() {
    for (const part of [errors, set, said]) if (part && part.textContent) part.classList.add("stale");
  }
  function live() {
    stale();
    send({ ask: "moving", marks }, (answer) => drawSigma(answer));
  }
  function settled() {
    stale();
    unknown.textContent = "";
    send({ ask: "sigma", marks }, (answer) => {
      drawSigma(answer);
      if (answer.error) return;
      const later = [];
      if (answer.broken) later.push([{ ask: "repair", marks }, drawRepair]);
      if (errors) later.push([{ ask: "accuracy", marks }, drawAccuracy]);
      if (set) later.push([{ ask: "projection", marks }, drawProjection]);
      // one after the other, and none of them once a mark moves again
      const after = () => {
        const [question, draw] = later.shift() || [];
        if (question) send(question, (found) => { draw(found); after(); });
      };
      after();
    });
  }

  for (const [name, verb] of [["Design", "design"], ...(opened.plan ? [["Plan", "plan"]] : []), ["Certify", "certify"], ["Horizons", "horizons"], ["Save", "save"]]) {
    const button = html("button", { "data-verb": verb, type: "button" }, buttons, name);
    button.addEventListener("click", () => {
      button.disabled = true;
      said.textContent = "…";
      const asked = JSON.stringify(marks);
      send({ ask: verb, marks, button: true }, (answer) => {
        button.disabled = false;
        said.textContent = answer.error || answer.said;
        if (answer.marks) { marks = answer.marks; drawLine(); settled(); }
        said.classList.toggle("stale", !answer.marks && JSON.stringify(marks) !== asked);
      });
    });
  }
  drawLine();
  settled();
  return root;
}

/* In a notebook: questions go through the model, answers come back by their number. */
async function render({ model, el }) {
  let number = 0;
  const open = new Map();
  model.on("msg:custom", (message) => { open.get(message.number)?.(message.answer); open.delete(message.number); });
  await mount(el, (question) => new Promise((resolve) => { number++; open.set(number, resolve); model.send({ number, question }); }));
}

export default { render };
