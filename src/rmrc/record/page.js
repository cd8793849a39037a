"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const EMPHASISED = 8;
const DECADES = 8;
const LEFT_MARGIN = 64;
const PRINT_WIDTH = 660;
let range = data.range.slice();
let printing = false;
// The names that are hidden in all panels, where the panels are linked.
const hidden = new Set();

const unpack = (text) =>
  new Float32Array(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
const time = unpack(data.time);

// Plotly reads a small HTML and %{…} in its texts; names are neither.
const plain = (text) =>
  text.replace(/[&<>%{}]/g, (letter) => `&#${letter.charCodeAt(0)};`);

function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

function colours() {
  const style = getComputedStyle(document.documentElement);
  const read = (name) => style.getPropertyValue(`--${name}`).trim();
  const names = ["text", "quiet", "line", "muted", "beyond", "limit", "page", "veil"];
  return {
    ...Object.fromEntries(names.map((name) => [name, read(name)])),
    series: read("series").split(" "),
  };
}

function unpackTrace(trace) {
  trace.x = trace.x ? unpack(trace.x) : time;
  trace.y = unpack(trace.y);
  if (trace.measured) unpackTrace(trace.measured);
}

function extent(...values) {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values.flatMap((item) => (item.length === undefined ? [item] : [...item]))) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  if (low > high) return [-1, 1];
  const space = 0.06 * (high - low) || 0.5 * Math.abs(high) || 1;
  return [low - space, high + space];
}

// A horizontal line over the whole width, with its name at the right end.
function mark(y, text, colour, theme, log) {
  return {
    shape: {
      type: "line", xref: "paper", x0: 0, x1: 1, y0: y, y1: y,
      line: { color: colour, width: 1, dash: "dot" },
    },
    annotation: {
      xref: "paper", x: 1, xanchor: "right", y: log ? Math.log10(y) : y, yanchor: "bottom",
      text, showarrow: false, font: { size: 11, color: colour }, bgcolor: theme.veil, borderpad: 0,
    },
  };
}

function lines(panel, theme) {
  const shown = panel.traces.filter((trace) => !panel.hidden.has(trace.name));
  // 0 is nowhere on a logarithmic axis.
  const marks = panel.marks.filter(({ y }) => !panel.log || y > 0).map(({ y, text }) =>
    mark(y, plain(text), theme.quiet, theme, panel.log));
  return {
    traces: shown.map((trace) => ({
      type: "scatter", mode: "lines", x: trace.x, y: trace.y, name: plain(trace.name),
      zorder: trace.layer ?? 0,
      line: { width: trace.width ?? 1.5, color: trace.colour(theme), dash: trace.dash },
      hovertemplate: `%{y:.4g} ${panel.unit}`,
    })),
    layout: {
      height: 230, hovermode: "x unified",
      yaxis: {
        ...(panel.log ? logarithmic(shown) : { type: "linear", range: extent(0, ...shown.map(({ y }) => y)) }),
        exponentformat: "power",
      },
      shapes: marks.map((each) => each.shape), annotations: marks.map((each) => each.annotation),
    },
  };
}

// About five ticks, at whole decades where there are more than two.
function logarithmic(traces) {
  const exponents = traces.flatMap((trace) => [...trace.y].filter((y) => y > 0).map(Math.log10));
  let [low, high] = extent(exponents);
  // What is left of an error when all is over is rounding: it would flatten the rest.
  const range = data.linked && high - low > DECADES ? [low = high - DECADES, high] : undefined;
  const dtick = high - low > 2 ? Math.round((high - low) / 5) || 1 : "D2";
  return { range, type: "log", dtick };
}

function allJoints(panel, theme) {
  const bounded = panel.traces.filter((trace) => trace.peak !== undefined);
  // The emphasised ones last, on top.
  const ordered = [...bounded].sort((a, b) => panel.top.has(a) - panel.top.has(b));
  const marks = [-1, 1].map((y) =>
    mark(y, y < 0 ? "lower limit" : "upper limit", theme.limit, theme));
  const [low, high] = extent(...bounded.flatMap(({ peak }) => [peak, -peak]));
  const beyond = [[-1, -1e6], [1, 1e6]].map(([y0, y1]) => ({
    type: "rect", xref: "paper", x0: 0, x1: 1, y0, y1, layer: "below",
    fillcolor: theme.beyond, line: { width: 0 },
  }));
  return {
    traces: ordered.map((trace) => {
      const [middle, half] = [(trace.upper + trace.lower) / 2, (trace.upper - trace.lower) / 2];
      return {
        type: "scatter", mode: "lines", x: trace.x, y: trace.y.map((y) => (y - middle) / half),
        customdata: trace.y, name: plain(trace.name),
        line: {
          width: panel.top.has(trace) ? 1.6 : 1,
          color: panel.top.has(trace) ? trace.colour(theme) : theme.muted,
        },
        hovertemplate: `<b>${plain(trace.name)}</b><br>%{customdata:.4g} ${trace.unit}, ` +
          `%{y:.0%} of the half range<br>at %{x:.4g} s<extra></extra>`,
      };
    }),
    layout: {
      height: 320, hovermode: "closest",
      yaxis: { range: [Math.min(low, -1.15), Math.max(high, 1.15)], tickformat: ".0%" },
      shapes: [...beyond, ...marks.map((each) => each.shape)],
      annotations: marks.map((each) => each.annotation),
    },
  };
}

function oneJoint(panel, theme) {
  const trace = panel.traces[panel.joint];
  const limits = [trace.lower, trace.upper].filter((limit) => limit !== undefined);
  const marks = limits.map((limit) =>
    mark(limit, `limit ${+limit.toPrecision(4)} ${trace.unit}`, theme.limit, theme));
  const curves = trace.measured
    ? [[trace.measured, "measured", theme.muted], [trace, "commanded", theme.series[0]]]
    : [[trace, plain(trace.name), theme.series[0]]];
  return {
    traces: curves.map(([curve, name, color]) => ({
      type: "scatter", mode: "lines", x: curve.x, y: curve.y, name, line: { width: 1.6, color },
      hovertemplate: `%{y:.4g} ${trace.unit}`,
    })),
    layout: {
      height: 320, hovermode: "x unified",
      yaxis: { range: extent(...curves.map(([curve]) => curve.y), ...limits) },
      shapes: marks.map((each) => each.shape), annotations: marks.map((each) => each.annotation),
    },
  };
}

function strip(panel, theme) {
  const count = panel.names.length;
  const scale = panel.colours.flatMap((colour, i) => [[i / count, colour], [(i + 1) / count, colour]]);
  return {
    traces: [{
      type: "heatmap", x: panel.edges, y: panel.rows.map((_, i) => i), z: panel.cells,
      colorscale: scale, zmin: -0.5, zmax: count - 0.5, showscale: false, ygap: 2,
      customdata: panel.cells.map((row, i) =>
        row.map((cell) => plain([panel.rows[i], panel.names[cell]].filter(Boolean).join(": ")))),
      hovertemplate: "%{customdata}<br>at %{x:.4g} s<extra></extra>",
    }],
    layout: {
      height: 34 + 24 * panel.rows.length, hovermode: "closest",
      yaxis: {
        fixedrange: true, autorange: "reversed", showgrid: false, showticklabels: false,
      },
      // Labels inside the plot, as joints' names are longer than the margin that all plots share.
      annotations: panel.rows.map((name, y) => ({
        xref: "paper", x: 0, xanchor: "left", y, text: plain(name), showarrow: false,
        bgcolor: theme.veil, borderpad: 1, font: { size: 12, color: theme.text },
      })).filter(({ text }) => text),
    },
  };
}

const KINDS = {
  lines,
  strip,
  joints: (panel, theme) => (panel.joint < 0 ? allJoints : oneJoint)(panel, theme),
};

function draw(panel) {
  const theme = colours();
  const { traces, layout } = KINDS[panel.kind](panel, theme);
  const axis = { gridcolor: theme.line, zeroline: false, ticks: "" };
  writeChips(panel, theme);
  return Plotly.react(panel.plot, traces, {
    ...layout,
    ...(printing ? { width: PRINT_WIDTH } : { autosize: true }),
    margin: { l: LEFT_MARGIN, r: 12, t: 10, b: 24 },
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", showlegend: false,
    font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: theme.quiet },
    hoverlabel: {
      bgcolor: theme.page, bordercolor: theme.line, font: { color: theme.text }, namelength: -1,
    },
    xaxis: {
      ...axis, range: range.slice(), ticksuffix: " s", hoverformat: ".4g",
      spikecolor: theme.quiet, spikethickness: 1, spikedash: "dot",
    },
    yaxis: { ...axis, ...layout.yaxis },
  }, {
    responsive: true, displayModeBar: false, doubleClick: "reset",
  });
}

// What a legend has of a curve: its colour and its name.
function chip(tag, text, colour, more, dash) {
  const swatch = element("i", { className: "swatch" });
  swatch.style.background = pattern(colour, dash);
  return element(tag, more, swatch, text);
}

function pattern(colour, dash) {
  const period = { dash: 5, dot: 2 }[dash];
  const stripes = `${colour} 0 ${period}px, transparent 0 ${period + 2}px`;
  return period ? `repeating-linear-gradient(90deg, ${stripes})` : colour;
}

function toggle(names, name) {
  names.delete(name) || names.add(name);
}

// The legend: a click hides a curve, or opens a joint.
function writeChips(panel, theme) {
  const redraw = (change) => () => { change(); data.linked ? drawAll() : draw(panel); };
  let chips = [];
  if (panel.kind === "lines" && panel.traces.length > 1) {
    chips = panel.traces.map((trace) => chip("button", trace.name, trace.colour(theme), {
      className: panel.hidden.has(trace.name) ? "off" : "",
      onclick: redraw(() => toggle(panel.hidden, trace.name)),
    }, trace.dash));
  } else if (panel.kind === "joints" && panel.joint < 0) {
    const others = panel.traces.filter((trace) => trace.peak !== undefined).length - panel.top.size;
    chips = [...panel.top].map((trace) => chip("button", trace.name, trace.colour(theme), {
      onclick: redraw(() => select(panel, panel.traces.indexOf(trace))),
    }));
    if (others > 0) chips.push(chip("span", `${others} further from their limits`, theme.muted));
  } else if (panel.kind === "joints" && panel.traces[panel.joint].measured) {
    chips = [chip("span", "commanded", theme.series[0]), chip("span", "measured", theme.muted)];
  } else if (panel.kind === "strip") {
    const used = new Set(panel.cells.flat());
    chips = panel.names
      .map((name, i) => used.has(i) && name && chip("span", name, panel.colours[i]))
      .filter(Boolean);
  }
  panel.chips.replaceChildren(...chips);
}

function select(panel, joint) {
  panel.joint = joint;
  panel.choice.value = joint;
}

function setUp(panel) {
  const controls = [];
  panel.traces?.forEach(unpackTrace);
  panel.traces?.forEach((trace, i) => {
    trace.colour = (theme) => theme.series[(trace.series ?? i) % theme.series.length];
  });
  if (panel.kind === "lines") {
    panel.hidden = data.linked ? hidden : new Set();
    const scale = element("button");
    const say = () => { scale.textContent = panel.log ? "linear axis" : "logarithmic axis"; };
    scale.onclick = () => {
      panel.log = !panel.log;
      say();
      draw(panel);
    };
    say();
    controls.push(scale);
  } else if (panel.kind === "joints") {
    const bounded = panel.traces.filter((trace) => trace.peak !== undefined);
    const loaded = [...bounded].sort((a, b) => b.peak - a.peak).slice(0, EMPHASISED);
    panel.top = new Set(bounded.filter((trace) => loaded.includes(trace)));
    // Few joints keep their colours from panel to panel; of many, those that stand out have one.
    if (panel.traces.length > EMPHASISED) {
      [...panel.top].forEach((trace, i) => { trace.colour = (theme) => theme.series[i]; });
    }
    const options = panel.traces.map((trace, i) =>
      element("option", { value: i, textContent: `${trace.name} [${trace.unit}]` }));
    if (bounded.length) {
      options.unshift(element("option", { value: -1, textContent: "all joints, share of the half range" }));
    }
    panel.choice = element("select", { ariaLabel: panel.title }, ...options);
    panel.choice.onchange = () => {
      panel.joint = +panel.choice.value;
      draw(panel);
    };
    select(panel, bounded.length ? -1 : 0);
    controls.push(panel.choice);
  } else {
    panel.edges = unpack(panel.edges);
  }
  const picture = element("button", { textContent: "picture", title: "save the plot as PNG" });
  picture.onclick = () =>
    Plotly.downloadImage(panel.plot, { format: "png", scale: 2, filename: panel.title });
  controls.push(picture);
  const title = element("h2", { textContent: panel.title });
  if (panel.unit) title.append(element("span", { className: "unit", textContent: ` [${panel.unit}]` }));
  panel.chips = element("div", { className: "chips" });
  panel.plot = element("div", { className: "plot" });
  document.getElementById("panels").append(element("section", { className: "panel" },
    element("div", { className: "head" }, title, ...controls), panel.chips, panel.plot));
}

// Zooming one panel in time zooms them all.
function link(panel) {
  panel.plot.on("plotly_relayout", (change) => {
    let wanted;
    if ("xaxis.range[0]" in change) wanted = [change["xaxis.range[0]"], change["xaxis.range[1]"]];
    else if ("xaxis.range" in change) wanted = change["xaxis.range"].slice();
    else if (change["xaxis.autorange"]) wanted = data.range.slice();
    if (!wanted || (wanted[0] === range[0] && wanted[1] === range[1])) return;
    range = wanted;
    for (const other of data.panels) Plotly.relayout(other.plot, { "xaxis.range": range.slice() });
  });
}

// A cell of a table that names a curve is its legend too.
function writeLegend() {
  const theme = colours();
  for (const cell of document.querySelectorAll("td[data-series]")) {
    const { name, series, dash } = cell.dataset;
    cell.parentElement.className = hidden.has(name) ? "off" : "";
    cell.replaceChildren(chip("button", cell.textContent, theme.series[series % theme.series.length], {
      onclick: () => { toggle(hidden, name); drawAll(); },
    }, dash));
  }
}

function drawAll() {
  writeLegend();
  return Promise.all(data.panels.map(draw));
}

data.panels.forEach(setUp);
drawAll().then(() => data.panels.forEach(link));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
addEventListener("beforeprint", () => { printing = true; drawAll(); });
addEventListener("afterprint", () => { printing = false; drawAll(); });
