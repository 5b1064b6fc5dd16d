/* A lecture that runs: served by `jupyter server --config run_lectures.py`, each cell can be changed and run.
   Opened from a disk or from any other server the page stays as it is. */
"use strict";
(() => {
  const place = location.pathname.indexOf("/static/");
  if (!location.protocol.startsWith("http") || place < 0) return;
  const base = location.pathname.slice(0, place + 1); // of the server: it may stand below other things
  const beside = new URL("ipywidgets.py", document.currentScript.src);
  const LONGEST = 20000; // characters of text that one cell may show
  const SHOWN = ["stream", "display_data", "execute_result", "error", "clear_output"];
  const GONE = "The server does not answer: it was stopped. Start it again by jupyter server --config run_lectures.py.";

  // the token of the address that the server printed; the other pages of this server find it here
  const given = new URLSearchParams(location.search).get("token");
  if (given) localStorage.setItem("token", given), history.replaceState(null, "", location.pathname + location.hash);
  const token = localStorage.getItem("token");
  const cookie = (document.cookie.match(/(?:^|; )_xsrf=([^;]*)/) || [])[1];
  const headers = { ...(token && { Authorization: `token ${token}` }), ...(cookie && { "X-XSRFToken": cookie }) };
  const ask = (path, options) => fetch(`${base}api/${path}`, { cache: "no-store", headers, ...options });

  const make = (tag, words = "", attributes = {}) => {
    const node = document.createElement(tag);
    node.textContent = words;
    Object.entries(attributes).forEach(([name, value]) => node.setAttribute(name, value));
    return node;
  };
  const button = (words, action, label) => {
    const made = make("button", words, { type: "button", ...(label && { "aria-label": label }) });
    made.addEventListener("click", action);
    return made;
  };

  // ---- the kernel of this page: started by the first run, gone with the page
  let id = null; // of the kernel, as the server knows it
  let kernel = null; // the connection to it
  let serial = 0;
  const session = Math.random().toString(36).slice(2);

  async function start() {
    say("Python is starting …", true);
    if (id === null) {
      const answer = await ask("kernels", { method: "POST", body: "{}" }).catch(() => null);
      if (!answer) throw new Error(GONE);
      if (answer.status === 403) throw new Error("The server was started anew: open the address that it has printed.");
      const told = await answer.json();
      if (!answer.ok) throw new Error(`The server cannot start Python: ${told.message || told.reason}`);
      id = told.id;
    }
    const query = `session_id=${session}${token ? `&token=${encodeURIComponent(token)}` : ""}`;
    const socket = new WebSocket(`${location.origin.replace("http", "ws")}${base}api/kernels/${id}/channels?${query}`);
    kernel = { socket, waiting: new Map() };
    socket.onmessage = (event) => heard(JSON.parse(event.data));
    await new Promise((opened) => (socket.onopen = socket.onerror = opened));
    socket.onclose = () => lose(GONE);
    if (socket.readyState !== WebSocket.OPEN) socket.onclose();
    const sliders = await (await fetch(beside)).text();
    const ready = await execute(
      `import sys, types; _ = types.ModuleType("ipywidgets"); exec(${JSON.stringify(sliders)}, vars(_)); ` +
        `_.interact = _.interact_live; sys.modules["ipywidgets"] = _; del _`,
      () => {},
    );
    if (ready.status === "error") throw new Error(`Python cannot begin: ${ready.ename}: ${ready.evalue}`);
  }

  function execute(code, show, counted = false) {
    const msg_id = `${session}-${++serial}`;
    const date = new Date().toISOString();
    const content = { code, silent: false, store_history: counted, allow_stdin: false, user_expressions: {} };
    const header = { msg_id, msg_type: "execute_request", session, username: "", date, version: "5.3" };
    return new Promise((resolve, reject) => {
      if (!kernel) return reject(new Error("Python was stopped."));
      kernel.waiting.set(msg_id, { show, resolve, reject });
      kernel.socket.send(JSON.stringify({ channel: "shell", header, parent_header: {}, metadata: {}, content }));
    });
  }

  function heard({ header, parent_header, content }) {
    const state = header.msg_type === "status" && content.execution_state;
    if (state === "restarting" || state === "dead")
      return lose("Python has ended in the middle: its names are gone.", state === "restarting");
    const asked = kernel && kernel.waiting.get(parent_header.msg_id);
    if (!asked) return;
    if (header.msg_type === "execute_reply") asked.reply = content;
    else if (state) asked.idle = state === "idle";
    else if (SHOWN.includes(header.msg_type)) asked.show(header.msg_type, content);
    if (!asked.reply || !asked.idle) return;
    kernel.waiting.delete(parent_header.msg_id);
    asked.resolve(asked.reply);
  }

  // let go of the kernel: what waits for it is told why, and every cell is to be run again
  function lose(why, serverStartsItAgain = false) {
    const gone = kernel;
    kernel = null;
    if (id !== null && !serverStartsItAgain) {
      ask(`kernels/${id}`, { method: "DELETE", keepalive: true }).catch(() => {});
      id = null;
    }
    if (!gone) return;
    gone.socket.onclose = null;
    gone.socket.close();
    gone.waiting.forEach((asked) => asked.reject(new Error(why)));
    cells.forEach((cell) => cell.mark(null, ""));
    say(why);
  }

  // ---- what a cell shows
  const plain = (text) => text.replace(/\x1b\[[0-9;]*[A-Za-z]/g, "").replace(/^.*\r(?!\n)/gm, "");
  const scrolled = (shown) => shown.classList.toggle("columns", (shown.textContent.match(/\S {2,}\S.*\n/g) || []).length > 1);
  const pre = (kind, text) => {
    const node = make("div", "", { class: `output ${kind} highlight-myst-ansi` }); // as the page was built
    node.append(make("div", "", { class: "highlight" }));
    node.firstChild.append(make("pre", text));
    scrolled(node.querySelector("pre"));
    return node;
  };
  const picture = (source, label) => make("img", "", { src: source, alt: label });

  function drawn(data, label) {
    const node = make("div", "", { class: "output" });
    if (data["text/html"]) node.innerHTML = data["text/html"]; // a browser runs no <script> that comes this way
    else if (data["image/svg+xml"])
      node.append(picture(`data:image/svg+xml,${encodeURIComponent(data["image/svg+xml"])}`, label));
    else if (data["image/png"]) node.append(picture(`data:image/png;base64,${data["image/png"]}`, label));
    else if (data["text/latex"]) {
      node.textContent = data["text/latex"].replace(/^\$+([^]*?)\$+$/, "\\($1\\)");
      setTimeout(() => window.MathJax && MathJax.typesetPromise([node])); // when it stands in the page
    } else return pre("text_plain", data["text/plain"] || "");
    return node;
  }

  function failed({ ename, evalue, traceback }) {
    const text = plain(traceback.join("\n")).replace(/^-+\n/, "");
    const line = (text.match(/Cell In\[\d+\], line (\d+)/) || [])[1];
    const asks = ename === "StdinNotImplementedError";
    const why = asks ? "a page cannot be asked for input: write the value into the cell." : plain(evalue);
    const node = make("div", "", { class: "output live-error" });
    const head = make("p");
    head.append(make("strong", ename), `${line ? ` in line ${line}` : ""}${why && `: ${why}`}`);
    const details = make("details");
    details.append(make("summary", "Traceback"), make("pre", text));
    node.append(head, ...(text ? [details] : []));
    return node;
  }

  // return what puts messages of a run into `output`, text up to LONGEST characters
  function shower(output, label) {
    let left = LONGEST;
    let fresh = true; // what the last run has left stays until there is something new: the page does not jump
    const cut = (text) => {
      const kept = text.slice(0, Math.max(left, 0));
      const last = left > 0 && text.length > left;
      left -= text.length;
      return [kept, last];
    };
    const put = (node) => (output.append(node), node);
    const show = (type, content) => {
      if (fresh) output.replaceChildren();
      fresh = false;
      if (type === "clear_output") output.replaceChildren();
      else if (type === "error") put(failed(content));
      else if (type === "display_data" || type === "execute_result") sliders(put(drawn(content.data, label)), label);
      else if (type === "stream") {
        const [kept, last] = cut(plain(content.text));
        const before = output.lastElementChild;
        if (before && before.matches(`.${content.name}`)) before.querySelector("pre").append(kept), scrolled(before.querySelector("pre"));
        else if (kept) put(pre(`stream ${content.name}`, kept));
        if (last) put(make("p", `The rest is not shown: a cell shows ${LONGEST} characters of text.`));
      }
    };
    show.end = () => fresh && output.replaceChildren();
    return show;
  }

  // a slider that takes any value, and draws by the function of the notebook
  function sliders(node, label) {
    node.querySelectorAll("[data-slider]").forEach((steps) => {
      const [slider, number] = steps.querySelectorAll("input");
      const output = steps.appendChild(make("div", "", { "aria-live": "polite" }));
      const mine = kernel;
      let busy = false;
      let again = false;
      steps.draw = async () => {
        if (kernel !== mine) return say("Run the cell again: its slider belongs to a Python that is gone.");
        if ((again = busy)) return;
        busy = true;
        const code = `__import__("ipywidgets").draw(${steps.dataset.slider}, ${Number(number.value)})`;
        const show = shower(output, label);
        await execute(code, show).then(show.end, (why) => say(why.message));
        busy = false;
        if (again) await steps.draw();
      };
      slider.addEventListener("input", () => (number.value = slider.value));
      slider.addEventListener("change", steps.draw);
      number.addEventListener("change", () => ((slider.value = number.value), steps.draw()));
    });
  }

  // ---- cells
  const PARTS = new RegExp(
    "(?<c1>#.*)|(?<s2>[rbf]{0,2}(?:\"\"\"[^]*?(?:\"\"\"|$)|'''[^]*?(?:'''|$)|\"(?:\\\\.|[^\"\\\\\\n])*\"?|'(?:\\\\.|[^'\\\\\\n])*'?))" +
      "|(?<mf>\\b\\d[\\d_.]*(?:e[+-]?\\d+)?)|(?<k>\\b(?:False|None|True|and|as|assert|break|class|continue|def|del|elif|" +
      "else|except|finally|for|from|global|if|import|in|is|lambda|not|or|pass|raise|return|try|while|with|yield)\\b)",
    "g",
  );
  function coloured(code) {
    const parts = [];
    let end = 0;
    for (const found of code.matchAll(PARTS)) {
      const [kind] = Object.entries(found.groups).find(([, text]) => text !== undefined);
      parts.push(code.slice(end, found.index), make("span", found[0], { class: kind }));
      end = found.index + found[0].length;
    }
    return [...parts, code.slice(end), "\n"];
  }

  // what was changed is kept with the tab: the code of the page -> the code that stands there now
  const kept = JSON.parse(sessionStorage.getItem(location.pathname) || "{}");
  const keep = (original, code) => {
    kept[original] = code;
    sessionStorage.setItem(location.pathname, JSON.stringify(kept));
  };

  function liven(node, number) {
    const shown = node.querySelector(".cell_input pre");
    const original = shown.textContent.replace(/\n$/, "");
    const name = original ? `cell ${number}` : "your own cell";
    const code = make("textarea", "", { "aria-label": `Code of ${name}`, autocapitalize: "off", autocomplete: "off" });
    code.spellcheck = false;
    code.value = kept[original] ?? original;
    const output = node.querySelector(".cell_output") || node.appendChild(make("div", "", { class: "cell_output docutils container" }));
    output.setAttribute("aria-live", "polite");
    const count = make("span", "", { class: "live-count" });
    const back = button("Undo changes", () => (edit(original), code.focus()), `Undo changes of ${name}`);
    const tools = make("div", "", { class: "live-tools" });
    tools.append(count, back, button("Run", () => runTo(cell), `Run ${name} (Shift+Enter)`));
    shown.parentNode.classList.add("live-code");
    shown.after(code);
    node.querySelector(".cell_input").append(tools);

    // what it shows is of the code `shown`, of run `at` (0: of the page); in run `changed` that became another one
    const cell = { node, name, ran: null, code, output, shown: original, at: 0, changed: 0, stale: false };
    cell.mark = (ran, words) => {
      cell.ran = ran;
      count.textContent = words;
      node.classList.toggle("live-waits", words === "waits" || words === "runs");
      code.dispatchEvent(new Event("input"));
    };
    const edit = (text) => {
      code.value = text;
      code.dispatchEvent(new Event("input"));
    };
    code.addEventListener("input", () => {
      shown.replaceChildren(...coloured(code.value));
      back.hidden = code.value === original;
      node.classList.toggle("live-changed", cell.ran !== null && cell.ran !== code.value);
      keep(original, code.value);
      judge();
    });
    code.addEventListener("keydown", (event) => {
      const before = code.value.slice(0, code.selectionStart);
      const blanks = before.match(/ *$/)[0].length;
      const insert = (text) => (event.preventDefault(), document.execCommand("insertText", false, text));
      if (event.key === "Enter" && (event.shiftKey || event.ctrlKey || event.metaKey)) {
        event.preventDefault();
        runTo(cell);
      } else if (event.key === "Enter" && !event.isComposing)
        insert("\n" + before.match(/ *(?=[^\n]*$)/)[0] + (/:\s*$/.test(before) ? "    " : ""));
    });
    edit(code.value);
    return cell;
  }

  // mark the cells whose output is older than a change of one above
  let runs = 0;
  function judge() {
    let latest = 0;
    cells.forEach((cell) => {
      cell.stale = latest > cell.at;
      cell.node.classList.toggle("live-stale", cell.stale && cell.output.childElementCount > 0);
      latest = cell.code.value === cell.shown ? Math.max(latest, cell.changed) : Infinity;
    });
  }

  // run a cell, and before it those above that have not run as they stand; stop where one fails
  let line = Promise.resolve();
  let stopped = 0;
  function runTo(last, all = false) {
    const mine = stopped;
    const asked = cells.slice(0, cells.indexOf(last) + 1);
    line = line.then(async () => {
      const todo = asked.filter((cell) => all || cell === last || cell.stale || cell.ran !== cell.code.value);
      todo.forEach((cell) => cell.mark(null, "waits"));
      try {
        if (mine === stopped && !kernel) await start();
        for (const cell of todo) if (mine !== stopped || !(await run(cell))) break;
      } catch (why) {
        say(why.message);
      }
      todo.forEach((cell) => cell.ran === null && cell.mark(null, ""));
    });
    return line;
  }

  async function run(cell) {
    const code = cell.code.value;
    cell.mark(null, "runs");
    say(`Running ${cell.name} …`, true);
    const show = shower(cell.output, `Picture of ${cell.name}`);
    const reply = await execute(code, show, true).catch((why) => {
      show("error", { ename: "Stopped", evalue: why.message, traceback: [] });
      throw why;
    });
    show.end();
    cell.at = ++runs;
    if (code !== cell.shown) cell.changed = runs;
    cell.shown = code;
    cell.mark(code, reply.execution_count ? `[${reply.execution_count}]` : "");
    const well = reply.status === "ok";
    for (const steps of well ? cell.output.querySelectorAll("[data-slider]") : []) await steps.draw();
    const ran = cells.filter((each) => each.ran === each.code.value).length;
    const failure = reply.ename === "KeyboardInterrupt" ? "was interrupted" : "has failed";
    say(well ? `${ran} of ${cells.length} cells have run.` : `Stopped: ${cell.name} ${failure}.`);
    if (!well) cell.node.scrollIntoView({ block: "nearest" });
    return well;
  }

  // ---- the bar of the page
  let cells = [];
  const bar = make("div", "", { class: "live-bar", role: "region", "aria-label": "Python of this page" });
  const said = make("span", "", { role: "status" });
  const say = (words, busy = false) => {
    said.textContent = words;
    bar.classList.toggle("live-busy", busy);
  };

  async function interrupt() {
    stopped += 1;
    if (kernel) await ask(`kernels/${id}/interrupt`, { method: "POST" }).catch(() => {});
  }

  async function begin() {
    const answer = await ask("kernels").catch(() => null);
    if (!answer || ![200, 403].includes(answer.status)) return; // some other server
    document.querySelector("article").append(bar);
    document.body.classList.add("live");
    bar.append(said);
    if (answer.status === 403) {
      say("Cells do not run: this server does not know you. Open the address that it has printed, or ");
      const next = encodeURIComponent(location.pathname);
      return said.append(make("a", "log in", { href: `${base}login?next=${next}` }), ".");
    }
    const nodes = [...document.querySelectorAll("article div.cell")].filter((each) => each.querySelector(".cell_input pre"));
    if (!nodes.length) return say("Open a lecture: its cells can be changed and run.");
    const own = make("div", "", { class: "cell" });
    own.innerHTML = '<div class="cell_input docutils container"><div class="highlight"><pre></pre></div></div>';
    const exercises = document.querySelector("#exercises");
    if (exercises) exercises.append(own), nodes.push(own);
    nodes.sort((a, b) => (a.compareDocumentPosition(b) & Node.DOCUMENT_POSITION_FOLLOWING ? -1 : 1));
    cells = nodes.map((node, k) => liven(node, k + 1));
    judge();
    bar.append(
      button("Run all", () => runTo(cells[cells.length - 1], true)),
      button("Interrupt", interrupt),
      button("Restart", () => (stopped++, lose("Python is gone with all names; the next run starts a new one."))),
    );
    say("Change a cell and press Shift+Enter. Its first run also runs those above.");
    addEventListener("pagehide", () => lose("Python has ended with the page."));
  }
  begin();
})();
