"use strict";
(() => {
  const figures = JSON.parse(document.getElementById("figures").textContent);
  // plotly.js 4 offers by default to upload a figure to a server: nothing may leave this file.
  const options = { responsive: true, displaylogo: false, showSendToCloud: false,
    plotlyServerURL: "", displayModeBar: innerWidth < 560 ? false : "hover" };
  const place = (name) => document.querySelector(`#${name} > .live`);
  const colour = (name) =>
    getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const make = (tag, parent, properties) =>
    parent.appendChild(Object.assign(document.createElement(tag), properties));

  // ---- figures ----------------------------------------------------------------------------

  // "$beam" and the like stand for colours of the theme.
  const themed = (value) => {
    if (typeof value === "string") return value[0] === "$" ? colour(value.slice(1)) : value;
    if (Array.isArray(value)) return value.map(themed);
    if (value && typeof value === "object") {
      return Object.fromEntries(Object.entries(value).map(([key, entry]) =>
        [key, key === "bdata" || key === "meta" ? entry : themed(entry)]));
    }
    return value;
  };

  const axis = (given) => ({ ...given, gridcolor: colour("grid"), zerolinecolor: colour("grid"),
    linecolor: colour("edge") });

  // A narrow screen shows less across, so look from further away there.
  const fitted = (name, { eye, center, up }) => {
    const box = place(name);
    const far = Math.max(1, 0.94 * box.clientHeight / Math.max(box.clientWidth, 1));
    const from = (axis) => center[axis] + far * (eye[axis] - center[axis]);
    return { center, up, eye: { x: from("x"), y: from("y"), z: from("z") } };
  };

  const layout = (name, given) => {
    const result = { ...themed(given), autosize: true, paper_bgcolor: "rgba(0,0,0,0)",
      plot_bgcolor: "rgba(0,0,0,0)", font: { color: colour("ink"), size: 12 },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("cloud"), activecolor: colour("accent") },
      hoverlabel: { bgcolor: colour("card"), bordercolor: colour("edge"),
        font: { color: colour("ink") } } };
    for (const name of ["xaxis", "yaxis"]) if (given[name]) result[name] = axis(result[name]);
    if (given.scene) {
      // What a person turned stays as it is when colours change.
      const camera = place(name).layout?.scene?.camera ?? fitted(name, given.scene.camera);
      result.scene = { ...result.scene, camera };
      for (const name of ["xaxis", "yaxis", "zaxis"]) {
        result.scene[name] = { ...axis(result.scene[name]), showbackground: false,
          showspikes: false };
      }
      result.legend = { ...result.legend, bgcolor: "rgba(0,0,0,0)" };
      result.uirevision = "kept";
    }
    return result;
  };

  let chosen = null;
  let shade = null;
  const perVertex = (trace, values) => values.flatMap((v, n) => Array(trace.meta.counts[n]).fill(v));
  const labelled = (trace) => {
    if (!trace.meta) return trace;
    const result = { ...trace, text: perVertex(trace, trace.meta.labels) };
    const shades = trace.meta.shades;
    if (shades) {
      const { colours, of } = shades[shade] ?? Object.values(shades)[0];
      const each = of.map((kind, n) => colour(n === chosen ? "chosen" : colours[kind].slice(1)));
      result.vertexcolor = perVertex(trace, each);
    }
    return result;
  };

  const canDraw3d = () => {
    const context = document.createElement("canvas").getContext("webgl");
    context?.getExtension("WEBGL_lose_context")?.loseContext();
    return Boolean(context);
  };

  const draw = async (name) => {
    const figure = figures[name];
    const fresh = !place(name).classList.contains("js-plotly-plot");
    if (fresh && figure.layout.scene && !canDraw3d()) return;
    await Plotly.react(place(name), figure.data.map((trace) => labelled(themed(trace))),
      layout(name, figure.layout), options);
    place(name).parentElement.classList.add("drawn");
    if (fresh && figure.layout.scene) place(name).on("plotly_click", chooseInScene);
  };
  const drawn = () =>
    Object.keys(figures).filter((name) => place(name).classList.contains("js-plotly-plot"));
  const redraw = () => drawn().forEach(draw);

  const unpacked = async () => {
    const packed = Uint8Array.from(atob(document.getElementById("plotly").textContent),
      (character) => character.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).text();
  };

  // The page is on the screen before the library is unpacked; a figure is drawn when it comes near.
  const start = async () => {
    if (!Object.keys(figures).length || !("DecompressionStream" in window)) return;
    document.head.append(Object.assign(document.createElement("script"),
      { textContent: await unpacked() }));
    const observer = new IntersectionObserver((entries) => entries.forEach((entry) => {
      if (!entry.isIntersecting) return;
      observer.unobserve(entry.target);
      draw(entry.target.id);
    }), { rootMargin: "300px" });
    Object.keys(figures).forEach((name) => observer.observe(document.getElementById(name)));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  };
  requestAnimationFrame(() => setTimeout(start, 30));

  // ---- views and colours ------------------------------------------------------------------

  const press = (button) => button.parentElement.querySelectorAll("button").forEach((one) =>
    one.setAttribute("aria-pressed", String(one === button)));

  document.querySelectorAll("button[data-view]").forEach((button) =>
    button.addEventListener("click", () => {
      const name = button.parentElement.dataset.for;
      if (!drawn().includes(name)) return;
      press(button);
      const camera = fitted(name, figures[name].layout.meta.cameras[button.dataset.view]);
      Plotly.relayout(place(name), { "scene.camera": camera });
    }));

  const shades = figures.structure?.data.find((trace) => trace.meta?.shades)?.meta.shades ?? {};
  const showKey = () => {
    const key = document.getElementById("key");
    if (!key || !shades[shade]) return;
    const { names, colours, of } = shades[shade];
    key.replaceChildren();
    names.forEach((name, kind) => {
      const count = of.filter((one) => one === kind).length;
      if (!count) return;
      const entry = make("span", key, { className: "chip" });
      make("i", entry, { style: `background:var(--${colours[kind].slice(1)})` });
      entry.append(`${name} (${count})`);
    });
  };
  const select = document.getElementById("shade");
  if (select) {
    Object.keys(shades).forEach((name) => make("option", select, { value: name, textContent: name }));
    shade = select.value;
    select.addEventListener("change", () => {
      shade = select.value;
      showKey();
      if (drawn().includes("structure")) draw("structure");
    });
    showKey();
  }

  // ---- choosing a beam --------------------------------------------------------------------

  const choose = (beam) => {
    chosen = chosen === beam ? null : beam;
    document.querySelectorAll("tr[data-beam]").forEach((row) => {
      const marked = Number(row.dataset.beam) === chosen;
      row.classList.toggle("chosen", marked);
      row.setAttribute("aria-selected", String(marked));
    });
    if (drawn().includes("structure")) draw("structure");
  };

  function chooseInScene({ points: [{ data, pointNumber }] }) {
    if (!data.meta?.shades) return;
    let left = pointNumber;
    choose(data.meta.counts.findIndex((count) => (left -= count) < 0));
    document.querySelector("#segments-table tr.chosen")?.scrollIntoView({ block: "nearest" });
  }

  // ---- tables -----------------------------------------------------------------------------

  const text = (cell) => cell.textContent.trim();
  const compare = (column, numeric, sign) => (one, other) => {
    const [a, b] = [one, other].map((row) => text(row.cells[column]));
    if (!numeric) return sign * a.localeCompare(b, undefined, { numeric: true });
    const [x, y] = [parseFloat(a), parseFloat(b)];
    if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) - Number.isNaN(y);
    return sign * (x - y);
  };

  // "poor", or "length>1.5": every word must fit the row.
  const fits = (heads, word) => {
    const [, name, sign, value] = word.match(/^(.+?)(<=|>=|<|>|=)(-?[\d.]+)$/) ?? [];
    const column = name ? heads.findIndex((head) =>
      [head.dataset.name, text(head)].some((known) => known.toLowerCase().startsWith(name))) : -1;
    if (column < 0) return (row) => row.textContent.toLowerCase().includes(word);
    const limit = parseFloat(value);
    const test = { "<": (x) => x < limit, ">": (x) => x > limit, "=": (x) => x === limit,
      "<=": (x) => x <= limit, ">=": (x) => x >= limit }[sign];
    return (row) => test(parseFloat(text(row.cells[column])));
  };

  const toClipboard = async (content) => {
    try {
      await navigator.clipboard.writeText(content);
    } catch {
      const area = make("textarea", document.body, { value: content });
      area.select();
      document.execCommand("copy");
      area.remove();
    }
  };

  const quoted = (content) =>
    /[",\n]/.test(content) ? `"${content.replaceAll('"', '""')}"` : content;

  const enhance = (listing) => {
    const table = listing.querySelector("table.data");
    const body = table.tBodies[0];
    const heads = [...table.tHead.rows[0].cells];
    const rows = [...body.rows];
    const tools = document.createElement("div");
    tools.className = "tools";
    listing.prepend(tools);
    const filter = make("input", tools, { type: "search", placeholder: "filter: words or length>1",
      ariaLabel: "Filter the rows" });
    if (heads.some((head) => head.classList.contains("m"))) {
      const label = make("label", tools, {});
      const box = make("input", label, { type: "checkbox" });
      label.append("all columns");
      box.addEventListener("change", () => table.classList.toggle("all", box.checked));
    }
    const copy = make("button", tools, { type: "button", textContent: "Copy as CSV" });
    const number = (count) => `${count} row${count === 1 ? "" : "s"}`;
    const count = make("output", tools, { textContent: number(rows.length) });

    filter.addEventListener("input", () => {
      const tests = filter.value.toLowerCase().split(/\s+/).filter(Boolean)
        .map((word) => fits(heads, word));
      rows.forEach((row) => { row.hidden = !tests.every((test) => test(row)); });
      stopAtFirst(body);
      const shown = rows.filter((row) => !row.hidden).length;
      count.textContent = (shown < rows.length ? `${shown} of ` : "") + number(rows.length);
    });

    copy.addEventListener("click", async () => {
      const columns = heads.map((head, n) => n)
        .filter((n) => getComputedStyle(heads[n]).display !== "none");
      const lines = [heads, ...[...body.rows].filter((row) => !row.hidden).map((row) => row.cells)]
        .map((cells) => columns.map((n) => quoted(text(cells[n]))).join(","));
      await toClipboard(lines.join("\n") + "\n");
      copy.textContent = "Copied";
      setTimeout(() => { copy.textContent = "Copy as CSV"; }, 1500);
    });

    heads.forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const falling = head.ariaSort === "ascending";
        heads.forEach((other) => other.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", falling ? "descending" : "ascending");
        const numeric = !head.classList.contains("t");
        body.append(...[...body.rows].sort(compare(column, numeric, falling ? -1 : 1)));
        stopAtFirst(body);
      });
    });
  };

  // One stop for Tab, arrows from there on.
  const stopAtFirst = (body) => {
    const rows = [...body.querySelectorAll("tr[data-beam]")];
    rows.forEach((row) => { row.tabIndex = -1; });
    const first = rows.find((row) => !row.hidden);
    if (first) first.tabIndex = 0;
  };

  const enableRows = (body) => {
    if (!body.querySelector("tr[data-beam]")) return;
    stopAtFirst(body);
    body.addEventListener("click", ({ target }) => {
      const row = target.closest("tr[data-beam]");
      if (row) choose(Number(row.dataset.beam));
    });
    body.addEventListener("keydown", (event) => {
      const row = event.target.closest("tr[data-beam]");
      if (!row) return;
      const step = { ArrowDown: "nextElementSibling", ArrowUp: "previousElementSibling" }[event.key];
      if (step) {
        let next = row[step];
        while (next?.hidden) next = next[step];
        next?.focus();
      } else if (event.key === "Enter" || event.key === " ") {
        choose(Number(row.dataset.beam));
      } else {
        return;
      }
      event.preventDefault();
    });
  };

  document.querySelectorAll(".listing").forEach(enhance);
  document.querySelectorAll(".data tbody").forEach(enableRows);

  // ---- print ------------------------------------------------------------------------------

  let opened = [];
  addEventListener("beforeprint", () => {
    opened = [...document.querySelectorAll("details:not([open])")];
    opened.forEach((one) => { one.open = true; });
  });
  addEventListener("afterprint", () => opened.forEach((one) => { one.open = false; }));
})();
