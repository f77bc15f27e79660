"use strict";
// Hands the charts of this page to plotly.js, and keeps what the reader has chosen: a person, a model, light or dark.
(() => {
  const root = document.documentElement;
  const find = (id) => document.getElementById(id);
  const page = JSON.parse(find("page-data").textContent);
  const { x, people, curves } = page;
  const state = { person: page.first, when: page.models.at(-1) };
  if (!window.Plotly) return;
  root.classList.add("js");

  // ------------------------------------------------------------------ what to draw
  // plotly.js reads markup in names; those of this page are plain text.
  const plain = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/%\{/g, "% {");
  const colour = (role) => getComputedStyle(root).getPropertyValue(`--c-${role}`).trim();
  const now = (item) => !item.when || item.when === state.when;
  const hover = (label) => `<b>%{text}</b><br>%{x:.4~s}Hz<br>${plain(label)}: %{y:.4~g}<extra></extra>`;

  function ribbon(name, low, high, role, common, grid = x) {
    const at = grid.map((_, i) => i).filter((i) => low[i] !== null && high[i] !== null);
    const edge = (row, more) => ({
      ...common, ...more, x: at.map((i) => grid[i]), y: at.map((i) => row[i]), mode: "lines", line: { width: 0 },
    });
    return [
      edge(low, { text: `${plain(name)}, lower end`, showlegend: false }),
      edge(high, { text: `${plain(name)}, upper end`, name: plain(name), fill: "tonexty", fillcolor: colour(role) }),
    ];
  }

  // A person's values as they are drawn: relative to a curve, if there is one.
  function drawnOf(own) {
    const over = own.over[""] || own.over[state.when];
    return (row) => (over ? row.map((v, i) => (v === null || over[i] === null ? null : v / over[i])) : row);
  }

  function everybody(panel, common) {
    const own = panel.people;
    const shared = { ...common, mode: "lines", connectgaps: false };
    const shown = drawnOf(own);
    const xs = [], ys = [], names = [];
    curves[own.values].forEach((row, i) => {
      xs.push(...x, null); ys.push(...shown(row), null); names.push(...x.map(() => plain(people[i])), "");
    });
    const width = people.length > 1 ? 0.8 : 1.8;
    const all = {
      ...shared, x: xs, y: ys, text: names, name: plain(own.name), line: { width, color: colour(own.colour) },
      opacity: Math.min(0.9, Math.max(0.25, 20 / people.length)), meta: "people",
    };
    if (people.length === 1) return [all];
    const text = plain(people[state.person]);
    const line = { width: 2.6, color: colour("chosen") };
    return [all, { ...shared, x, y: shown(curves[own.values][state.person]), text, name: "chosen", line, meta: "one" }];
  }

  function ofPerson(own, common) {
    const row = (curves[own.values] || [])[state.person];
    if (!row) return [];
    if (own.mirrored) return ribbon(own.name, row.map((v) => v === null ? null : -v), row, own.colour, common);
    const style = own.points
      ? { mode: "markers", marker: { size: 4.5, color: colour(own.colour) } }
      : { mode: "lines", line: { width: 2, color: colour(own.colour) } };
    return [{ ...common, ...style, x, y: row, text: plain(own.name), name: plain(own.name) }];
  }

  function cells(panel, chart, common) {
    const rows = chart.order.map((i) => panel.cells[state.when][i]);
    const inner = x.slice(1).map((f, i) => Math.sqrt(f * x[i]));
    const end = x.length - 1;
    const edges = end ? [x[0] ** 2 / inner[0], ...inner, x[end] ** 2 / inner[end - 1]] : [x[0] / 1.1, x[0] * 1.1];
    return [{
      ...common, type: "heatmap", x: edges, z: rows, zmin: -4, zmax: 4,
      colorscale: [[0, colour("low")], [0.5, colour("mid")], [1, colour("high")]],
      colorbar: { title: { text: "residual / sd", side: "right" }, thickness: 12, len: 0.8 },
      showscale: common.yaxis === "y", meta: "cells", hoverongaps: false,
      text: rows.map((row, i) => row.map(() => plain(people[chart.order[i]]))),
      hovertemplate: "<b>%{text}</b><br>%{x:.4~s}Hz<br>residual: %{z:.2f} standard deviations<extra></extra>",
    }];
  }

  function axisStyle(more) {
    return {
      color: colour("text"), gridcolor: colour("grid"), zerolinecolor: colour("zero"), linecolor: colour("zero"),
      showline: true, automargin: true, exponentformat: "SI", ...more,
    };
  }

  // Ticks of a logarithmic axis: the decades alone, 1, 2 and 5 of each, or some more; Plotly's own would overlap.
  function decades(panel) {
    const rows = [...panel.lines.map((line) => line.y), ...panel.ribbons.flatMap((band) => [band.low, band.high])];
    if (panel.people) rows.push(...curves[panel.people.values].map(drawnOf(panel.people)));
    for (const own of panel.own || []) rows.push((curves[own.values] || [])[state.person] || []);
    const values = rows.flat().filter((v) => v > 0).map(Math.log10);
    const span = values.reduce((a, b) => Math.max(a, b), -9) - values.reduce((a, b) => Math.min(a, b), 9);
    const several = Array.from({ length: 24 }, (_, k) => [1, 1.5, 2, 3, 5, 7].map((v) => v * 10 ** (k - 12))).flat();
    const fewer = span > 0.35 ? { tickmode: "array", tickvals: several } : {};
    return { tickformat: "~g", ...(span > 2.5 ? { dtick: 1 } : span > 0.8 ? { dtick: "D2" } : fewer) };
  }

  function figureOf(chart, narrow) {
    const data = [], shapes = [], layout = {};
    const grid = chart.x || x;
    const listed = new Set();
    const many = chart.panels.length, gap = 0.07;
    chart.panels.forEach((panel, i) => {
      const key = i ? `y${i + 1}` : "y";
      const common = { xaxis: "x", yaxis: key, type: "scatter", hovertemplate: hover(panel.label) };
      const added = panel.cells ? cells(panel, chart, common) : [];
      for (const b of panel.ribbons.filter(now)) added.push(...ribbon(b.name, b.low, b.high, b.colour, { ...common, ...seen(b) }, grid));
      if (panel.people) added.push(...everybody(panel, common));
      for (const own of (panel.own || []).filter(now)) added.push(...ofPerson(own, common));
      for (const line of panel.lines.filter(now)) {
        const drawn = { width: 2, color: colour(line.colour), dash: line.dash };
        added.push({ ...common, ...seen(line), x: grid, y: line.y, mode: "lines", text: plain(line.name), name: plain(line.name), line: drawn });
      }
      for (const trace of added) {
        if (trace.showlegend === false || trace.type === "heatmap") continue;
        trace.showlegend = !listed.has(trace.name);
        trace.legendgroup = trace.name;
        listed.add(trace.name);
      }
      data.push(...added);
      const height = (1 - gap * (many - 1)) / many, top = 1 - i * (height + gap);
      layout[`yaxis${i ? i + 1 : ""}`] = axisStyle({
        domain: [Math.max(top - height, 0), top], title: { text: plain(panel.label), standoff: 6 }, zeroline: !panel.log,
        type: panel.log ? "log" : "linear", rangemode: panel.zero ? "tozero" : "normal", nticks: 6,
        ...(panel.cells ? { autorange: "reversed", showticklabels: false, ticks: "", showgrid: false, zeroline: false } : {}),
        ...(panel.log ? decades(panel) : {}), ...(panel.limits ? { range: panel.limits } : {}),
      });
      // Shading would hide cells: there a bar above says which frequencies are meant.
      const [y0, y1, role] = panel.cells ? [1.01, 1.04, "orange"] : [0, 1, "shade"];
      const plainBox = { type: "rect", yref: `${key} domain`, y0, y1, fillcolor: colour(role), line: { width: 0 }, layer: "below" };
      for (const [x0, x1] of panel.shaded) shapes.push({ ...plainBox, x0, x1 });
      if (panel.cells) {
        const row = chart.order.indexOf(state.person);
        const line = { color: colour("chosen"), width: 2 };
        shapes.push({ type: "rect", xref: "x domain", x0: 0, x1: 1, yref: key, y0: row - 0.5, y1: row + 0.5, line });
      }
    });
    layout.xaxis = axisStyle({
      type: "log", anchor: many > 1 ? `y${many}` : "y", title: { text: "frequency (Hz)", standoff: 6 }, tickformat: "~g",
      range: [Math.log10(grid[0]), Math.log10(grid.at(-1))], dtick: narrow || grid.at(-1) > 1e4 * grid[0] ? 1 : "D2",
    });
    return { data, layout: { ...layout, shapes } };
  }
  const seen = (item) => (item.shown ? {} : { visible: "legendonly" });

  function elementsFigure() {
    const { names, middle, low, high } = page.elements;
    const label = "<b>%{text}</b><br>%{y}: %{x:+.2f} standard deviations from the centre<extra></extra>";
    const rows = people.flatMap((name, i) => names.map((element, k) => ({ i, name, element, at: middle[i][k] })));
    const i = state.person;
    const chosen = { color: colour("chosen") };
    return {
      data: [
        {
          type: "scatter", mode: "markers", name: "all", meta: "dots", customdata: rows.map((r) => r.i),
          x: rows.map((r) => r.at), y: rows.map((r) => r.element), text: rows.map((r) => plain(r.name)),
          marker: { size: 7, symbol: "line-ns-open", color: colour("people") }, hovertemplate: label,
        },
        {
          type: "scatter", mode: "markers", name: "chosen, with 90 % interval", x: middle[i], y: names,
          text: plain(people[i]), marker: { size: 11, ...chosen }, hovertemplate: label,
          error_x: {
            array: high[i].map((h, k) => h - middle[i][k]), arrayminus: low[i].map((l, k) => middle[i][k] - l), ...chosen,
          },
        },
      ],
      layout: {
        xaxis: axisStyle({ title: { text: "standard deviations from the population's centre", standoff: 6 } }),
        yaxis: axisStyle({ autorange: "reversed", type: "category" }),
      },
    };
  }

  // ------------------------------------------------------------------ drawing
  const boxes = [...document.querySelectorAll(".live[data-chart]")];
  const charts = new Map(page.charts.map((chart) => [chart.name, chart]));
  const config = {
    responsive: true, displaylogo: false, displayModeBar: true, doubleClick: "reset", showTips: false,
    plotlyServerURL: "", showSendToCloud: false,
    modeBarButtons: [["toImage"], ["zoom2d", "pan2d"], ["zoomIn2d", "zoomOut2d", "resetScale2d"]],
  };

  function draw(box) {
    const name = box.dataset.chart;
    const elements = name === "elements";
    const narrow = box.clientWidth < 560;
    const figure = elements ? elementsFigure() : figureOf(charts.get(name), narrow);
    const panels = elements ? 0 : charts.get(name).panels.length;
    box.style.height = `${elements ? 110 + 30 * page.elements.names.length : (panels === 1 ? 210 : 175) + (narrow ? 170 : 200) * panels}px`;
    const layout = {
      ...figure.layout, paper_bgcolor: colour("paper"), plot_bgcolor: colour("paper"), dragmode: narrow ? false : "zoom",
      font: { family: "system-ui, 'Segoe UI', Roboto, Helvetica, Arial, sans-serif", size: narrow ? 11 : 12.5, color: colour("text") },
      margin: { l: 12, r: 12, t: 32, b: 12 }, hovermode: "closest", uirevision: "kept",
      hoverlabel: { bgcolor: colour("tip"), font: { color: colour("text") }, bordercolor: colour("zero"), align: "left" },
      legend: { orientation: "h", x: 0, y: 1.02, xanchor: "left", yanchor: "bottom", font: { size: narrow ? 10 : 12 } },
      modebar: { color: colour("soft"), activecolor: colour("text"), bgcolor: "rgba(0,0,0,0)", orientation: "h" },
    };
    const first = !box.classList.contains("drawn");
    return Plotly.react(box, figure.data, layout, config).then(() => {
      box.classList.add("drawn");
      box.querySelectorAll("svg").forEach((svg) => svg.setAttribute("aria-hidden", "true"));
      if (first) listen(box);
    });
  }
  const redraw = () => boxes.filter((box) => box.classList.contains("drawn")).forEach(draw);

  function listen(box) {
    box.on("plotly_click", ({ points: [point] }) => {
      const kind = point.data.meta;
      if (kind === "people") choose(Math.floor(point.pointNumber / (x.length + 1)));
      else if (kind === "cells") choose(charts.get(box.dataset.chart).order[point.pointNumber[0]]);
      else if (kind === "dots") choose(point.customdata);
    });
    // Arrow keys step along the curves as the mouse does, and say the values.
    let trace = 0, at = -1;
    box.addEventListener("keydown", (event) => {
      const step = { ArrowRight: [0, 1], ArrowLeft: [0, -1], ArrowUp: [-1, 0], ArrowDown: [1, 0] }[event.key];
      if (!step || event.target !== box) return;
      event.preventDefault();
      const traces = box.data.map((_, i) => i).filter((i) => {
        const { meta, type, visible } = box.data[i];
        return type === "scatter" && visible !== "legendonly" && meta !== "people" && meta !== "dots";
      });
      if (!traces.length) return;
      trace = (trace + step[0] + traces.length) % traces.length;
      const { x: xs, y: ys, text } = box.data[traces[trace]];
      const end = xs.length - 1;
      do at = Math.min(Math.max(at + step[1], 0), end); while (step[1] && at > 0 && at < end && ys[at] === null);
      Plotly.Fx.hover(box, [{ curveNumber: traces[trace], pointNumber: at }], box.data[traces[trace]].yaxis ? undefined : ["xy"]);
      const axis = box.layout[(box.data[traces[trace]].yaxis || "y").replace("y", "yaxis")];
      const unit = axis.title && axis.title.text ? `, ${axis.title.text}` : "";
      say(`${text}: ${ys[at] === null ? "no value" : ys[at]} at ${xs[at]}${box.dataset.chart === "elements" ? "" : " Hz"}${unit}`);
    });
  }
  const say = (text) => { find("said").textContent = text; };

  // ------------------------------------------------------------------ what the reader chooses
  function choose(person, quietly) {
    state.person = (person + people.length) % people.length;
    const one = page.persons[state.person];
    const list = find("person-list");
    if (list) list.value = String(state.person);
    find("person-name").textContent = people[state.person];
    const facts = find("person-facts");
    facts.replaceChildren(...one.facts.map(([name, value]) => {
      const pair = document.createElement("div");
      for (const [tag, text] of [["dt", name], ["dd", value]]) {
        pair.appendChild(document.createElement(tag)).textContent = text;
      }
      return pair;
    }));
    const body = find("person-elements");
    if (body) {
      body.replaceChildren(...one.elements.map(([head, ...values]) => {
        const row = document.createElement("tr");
        const th = row.appendChild(document.createElement("th"));
        th.scope = "row";
        th.textContent = head;
        for (const value of values) {
          const cell = row.appendChild(document.createElement("td"));
          cell.className = "number";
          cell.textContent = value;
        }
        return row;
      }));
    }
    if (quietly) return;
    redraw();
    say(`${people[state.person]} is chosen`);
  }

  find("person-list")?.addEventListener("change", (event) => choose(Number(event.target.value)));
  document.querySelectorAll("[data-step]").forEach((button) =>
    button.addEventListener("click", () => choose(state.person + Number(button.dataset.step))));
  document.querySelectorAll("[data-person]").forEach((link) =>
    link.addEventListener("click", () => choose(Number(link.dataset.person))));
  document.querySelectorAll("input[name=model]").forEach((input) =>
    input.addEventListener("change", () => {
      state.when = input.value;
      redraw();
      document.querySelectorAll("[data-when]").forEach((part) => { part.hidden = part.dataset.when !== state.when; });
      say(`The charts show the network ${state.when}`);
    }));

  const dark = matchMedia("(prefers-color-scheme: dark)");
  const isDark = () => (root.dataset.theme || (dark.matches ? "dark" : "light")) === "dark";
  const theme = find("theme");
  const told = () => theme.setAttribute("aria-pressed", String(isDark()));
  theme.addEventListener("click", () => {
    root.dataset.theme = isDark() ? "light" : "dark";
    told();
    redraw();
  });
  dark.addEventListener("change", () => { told(); redraw(); });
  told();

  // What scrolls sideways can be reached with the keyboard; what does not is no stop on the way.
  const fit = new ResizeObserver((entries) => {
    for (const { target } of entries) {
      const wide = target.scrollWidth > target.clientWidth + 1;
      for (const [name, value] of [["tabindex", "0"], ["role", "group"], ["aria-label", "scrolls sideways"]]) {
        if (wide) target.setAttribute(name, value);
        else target.removeAttribute(name);
      }
    }
  });
  document.querySelectorAll(".scroll, pre, figure").forEach((part) => fit.observe(part));

  choose(state.person, true);
  const watch = new IntersectionObserver((entries) => {
    for (const { isIntersecting, target } of entries) {
      if (!isIntersecting) continue;
      watch.unobserve(target);
      draw(target);
    }
  }, { rootMargin: "600px" });
  boxes.forEach((box) => watch.observe(box));

  // On paper charts are as wide as the page, and light.
  const paper = boxes.filter((box) => box.classList.contains("printed"));
  addEventListener("beforeprint", () => {
    root.classList.add("printing");
    paper.forEach((box) => { draw(box); Plotly.relayout(box, { width: 660 }); });
  });
  addEventListener("afterprint", () => { root.classList.remove("printing"); redraw(); });
})();
