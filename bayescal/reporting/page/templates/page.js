"use strict";
// Interactive figures of the page, drawn from its own data. Nothing is fetched: plotly.js is inflated from
// the page. Where that is not possible, the drawings without script stay.
(() => {
  const started = performance.now();
  const data = JSON.parse(document.getElementById("data").textContent);
  const rows = data.rows, arm = data.arm, count = rows.id.length;
  const INK = "#22313f", QUIET = "#55616d", ACCENT = "#1b4f72", MARK = "#b03022", PALE = "#dfe5eb";
  const COLOURS = ["#1b4f72", "#d68910", "#3a8f6b", "#8e5ea2", "#5b8db8", "#a0522d", "#22313f", "#7b8794"];
  const SYMBOLS = ["circle", "diamond", "square", "circle-open", "diamond-open", "square-open"];
  const CONFIG = { displaylogo: false, responsive: true, modeBarButtonsToRemove: ["resetCameraLastSave3d", "lasso2d", "select2d"] };
  const FONT = { family: "system-ui, 'DejaVu Sans', sans-serif", size: 12, color: INK };

  // Plotly reads a few tags in labels and hover texts: names from files are shown as they are
  const plain = (text) => String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
  const radians = (degrees) => degrees * Math.PI / 180;
  const all = [...rows.id.keys()];
  const known = all.filter((k) => rows.residual_um[k] !== null && !rows.rejected[k]);
  const large = quantile(known.map((k) => Math.abs(rows.residual_um[k])), 0.97) || 1;

  function quantile(values, share) {
    const sorted = [...values].sort((a, b) => a - b);
    return sorted.length ? sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))] : 0;
  }

  async function inflated(id) {
    const packed = atob(document.getElementById(id).textContent.trim());
    const bytes = Uint8Array.from(packed, (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).text();
  }

  // Points of the arm at link angles (deg): each joint turns what follows it about its axis.
  function pose(angles) {
    let turn = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], shift = [0, 0, 0];
    const times = (m, v) => m.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
    const product = (a, b) => a.map((row) => [0, 1, 2].map((j) => row[0] * b[0][j] + row[1] * b[1][j] + row[2] * b[2][j]));
    const sum = (a, b) => a.map((v, k) => v + b[k]);
    const out = [arm.links_mm[0]];
    angles.forEach((angle, k) => {
      const [x, y, z] = arm.axes[k], c = Math.cos(radians(angle)), s = Math.sin(radians(angle)), v = 1 - c;
      const own = [[c + x * x * v, x * y * v - z * s, x * z * v + y * s],
        [y * x * v + z * s, c + y * y * v, y * z * v - x * s],
        [z * x * v - y * s, z * y * v + x * s, c + z * z * v]];
      const at = arm.links_mm[k + 1], moved = times(own, at);
      out.push(sum(times(turn, at), shift));
      shift = sum(times(turn, at.map((a, i) => a - moved[i])), shift);
      turn = product(turn, own);
    });
    out.push(sum(times(turn, arm.links_mm[arm.links_mm.length - 1]), shift));
    return out;
  }

  const column = (points, axis) => points.map((p) => p[axis]);
  const said = (k) => rows.residual_um[k] === null ? "no residual" : `${rows.residual_um[k].toFixed(1)} µm`;
  function hover(k) {
    const lines = [`<b>${plain(rows.id[k])}</b>  ${said(k)}`, `${plain(rows.target[k])}, ${rows.role[k] === "validate" ? "validation" : "fitted"}`];
    if (rows.rejected[k]) lines.push("rejected as an outlier");
    if (rows.time_s) lines.push(`time ${(rows.time_s[k] / 60).toFixed(1)} min`);
    lines.push(arm.joints.map((_, j) => `J${j + 1} ${rows.angle_deg[k][j].toFixed(1)}`).join(", ") + " deg");
    return lines.join("<br>");
  }

  // What contacts can be coloured by: a number of each row, or a group of each row.
  const NUMBERS = {
    "size of the residual": { of: (k) => rows.residual_um[k] === null ? null : Math.abs(rows.residual_um[k]), unit: "|residual| (µm)", top: large },
    ...(rows.time_s ? { "time": { of: (k) => rows.time_s[k] / 60, unit: "time (min)" } } : {}),
    ...Object.fromEntries(arm.joints.map((_, j) => [`angle of J${j + 1}`, { of: (k) => rows.angle_deg[k][j], unit: `J${j + 1} (deg)` }])),
  };
  const GROUPS = {
    "target": (k) => rows.target[k],
    "role": (k) => rows.role[k] === "validate" ? "validation" : "fitted",
    ...(rows.direction ? Object.fromEntries(arm.joints.map((_, j) => [`direction of motion of J${j + 1}`, (k) => ({ "+": "positive", "-": "negative", "0": "standstill" })[rows.direction[k][j]]])) : {}),
  };

  const shape = (k) => rows.residual_um[k] === null || rows.rejected[k] ? "circle-open" : rows.residual_um[k] >= 0 ? "circle" : "diamond";
  function traces(type, xyz, by, size, shaped) {
    const drawn = type === "scatter" ? all.filter((k) => rows.residual_um[k] !== null) : all; // no name without a dot
    const part = (some) => Object.fromEntries(Object.entries(xyz).map(([axis, values]) => [axis, some.map((k) => values[k])]));
    const base = (some) => ({ type, mode: "markers", ...part(some), customdata: some, text: some.map(hover), hoverinfo: "text", showlegend: false });
    if (NUMBERS[by]) {
      const { of, unit, top } = NUMBERS[by], values = all.map(of);
      const seen = drawn.filter((k) => values[k] !== null), rest = drawn.filter((k) => values[k] === null);
      const marker = { size: shaped ? seen.map((k) => size * (0.75 + 0.75 * Math.min(Math.abs(rows.residual_um[k] ?? 0) / large, 1))) : size, color: seen.map((k) => values[k]), colorscale: "Cividis", reversescale: true,
        symbol: seen.map(shape), line: { width: 0.5, color: QUIET }, colorbar: { title: { text: unit, side: "right" }, thickness: 12, len: 0.8 } };
      if (top) Object.assign(marker, { cmin: 0, cmax: top });
      const out = [{ ...base(seen), marker }];
      if (rest.length) out.push({ ...base(rest), marker: { size: 0.7 * size, color: QUIET, symbol: "circle-open", line: { width: 0.5, color: QUIET } } });
      return out;
    }
    const groups = [...new Set(drawn.map(GROUPS[by]))];
    return groups.map((name, g) => {
      const some = drawn.filter((k) => GROUPS[by](k) === name), short = name.length > 28 ? name.slice(0, 27) + "…" : name;
      return { ...base(some), name: plain(short), showlegend: true, marker: { size, color: COLOURS[g % COLOURS.length], symbol: SYMBOLS[g % SYMBOLS.length], line: { width: 0.5, color: "#fff" } } };
    });
  }

  function options(select, names, chosen) {
    for (const name of names) select.add(new Option(name, name, name === chosen, name === chosen));
  }

  function scene() {
    const at = document.getElementById("scene-plot");
    const colour = document.getElementById("scene-colour"), slider = document.getElementById("scene-row"), shown = document.getElementById("scene-pose");
    options(colour, [...Object.keys(NUMBERS), ...Object.keys(GROUPS)], "size of the residual");
    slider.max = String(count - 1);
    slider.value = String(data.typical);
    const length = 0.05 * Math.max(...[0, 1, 2].map((a) => Math.max(...column(rows.point_mm, a)) - Math.min(...column(rows.point_mm, a))));
    const marked = (k) => data.marks.joints.includes(k);
    const bodies = (k) => {
      const line = [...pose(rows.angle_deg[k]), rows.point_mm[k]], joints = line.slice(1, -2);
      const links = { type: "scatter3d", mode: "lines", x: column(line, 0), y: column(line, 1), z: column(line, 2), line: { width: 9, color: "#8f9ba7" }, hoverinfo: "skip", showlegend: false };
      const nodes = { type: "scatter3d", mode: "markers+text", x: column(joints, 0), y: column(joints, 1), z: column(joints, 2), text: joints.map((_, j) => marked(j + 1) ? `<b>J${j + 1}</b>` : `J${j + 1}`), hovertext: arm.joints.map((name, j) => `joint ${j + 1}: ${plain(name)}`), hoverinfo: "text",
        textposition: "top center", textfont: { size: 11, color: joints.map((_, j) => marked(j + 1) ? MARK : INK) }, showlegend: false,
        marker: { size: joints.map((_, j) => marked(j + 1) ? 11 : 6), color: joints.map((_, j) => marked(j + 1) ? MARK : "#fff"), line: { width: 2, color: INK } } };
      const red = { type: "scatter3d", mode: "lines", x: [], y: [], z: [], line: { width: 14, color: MARK }, hoverinfo: "skip", showlegend: false };
      const pieces = [...data.marks.links.map((j) => line.slice(j, j + 2)), ...(data.marks.tip ? [line.slice(-2)] : []), ...(data.marks.base ? [[line[0].map((v, a) => a === 0 ? v - length : v), line[0].map((v, a) => a === 0 ? v + length : v)]] : [])];
      for (const piece of pieces) for (const p of [...piece, [null, null, null]]) { red.x.push(p[0]); red.y.push(p[1]); red.z.push(p[2]); }
      return [links, nodes, red];
    };
    const axis = (name) => ({ title: { text: `${name} (mm)` }, backgroundcolor: "#fff", gridcolor: PALE, zerolinecolor: PALE, showspikes: false, tickfont: { size: 10 } });
    const layout = { font: FONT, margin: { l: 0, r: 0, t: 0, b: 0 }, uirevision: "same", legend: { orientation: "h", y: 0, yanchor: "bottom" }, hoverlabel: { bgcolor: "#fff", font: FONT, align: "left" },
      scene: { aspectmode: "data", xaxis: axis("x"), yaxis: axis("y"), zaxis: axis("z"), uirevision: "same", camera: { eye: data.eye, up: { x: 0, y: 0, z: 1 } } } };
    let row = data.typical;
    const draw = () => Plotly.react(at, [...bodies(row), ...traces("scatter3d", { x: column(rows.point_mm, 0), y: column(rows.point_mm, 1), z: column(rows.point_mm, 2) }, colour.value, 5, true)], layout, CONFIG);
    const move = (k) => {
      row = k;
      slider.value = String(k);
      shown.textContent = `${rows.id[k]}, ${said(k)}`;
      const parts = bodies(k);
      for (const axis of ["x", "y", "z"]) Plotly.restyle(at, { [axis]: parts.map((p) => p[axis]) }, [0, 1, 2]);
    };
    colour.addEventListener("change", draw);
    slider.addEventListener("input", () => move(Number(slider.value)));
    return draw().then(() => {
      shown.textContent = `${rows.id[row]}, ${said(row)}`;
      at.on("plotly_hover", (event) => { const k = event.points[0].customdata; if (Number.isInteger(k) && k !== row) move(k); });
    });
  }

  function residuals() {
    const at = document.getElementById("residual-plot");
    const over = document.getElementById("residual-x"), colour = document.getElementById("residual-colour");
    const directions = rows.direction ? Object.fromEntries(arm.joints.map((_, j) => [`direction of motion of J${j + 1}`, { of: (k) => ({ "+": "positive", "-": "negative", "0": "standstill" })[rows.direction[k][j]], unit: "" }])) : {};
    const X = { "row": { of: (k) => k + 1, unit: "row" }, ...NUMBERS, ...directions, "target": { of: (k) => plain(rows.target[k]), unit: "" } };
    delete X["size of the residual"];
    options(over, Object.keys(X), rows.time_s ? "time" : "row");
    options(colour, Object.keys(GROUPS), "target");
    const draw = () => {
      const x = X[over.value], values = all.map(x.of), text = typeof values[0] === "string";
      const noise = data.noise_um;
      const layout = { font: FONT, margin: { l: 60, r: 12, t: 8, b: text ? 90 : 48 }, hovermode: "closest", hoverlabel: { bgcolor: "#fff", font: FONT, align: "left" }, legend: { orientation: "h", y: 1.02, yanchor: "bottom" }, plot_bgcolor: "#fff",
        xaxis: { title: { text: x.unit }, gridcolor: PALE, zeroline: false, automargin: true, type: text ? "category" : "linear" }, yaxis: { title: { text: data.residual_label }, gridcolor: PALE, zerolinecolor: QUIET },
        shapes: noise === null ? [] : [{ type: "rect", xref: "paper", x0: 0, x1: 1, y0: data.signed ? -2 * noise : 0, y1: 2 * noise, fillcolor: "#e3e9ef", line: { width: 0 }, layer: "below" }] };
      return Plotly.react(at, traces("scatter", { x: values, y: rows.residual_um }, colour.value, 7, false), layout, CONFIG);
    };
    over.addEventListener("change", draw);
    colour.addEventListener("change", draw);
    return draw();
  }

  // The library takes seconds to inflate and to run: it is loaded once, for the first figure that comes near,
  // and after the page with its still drawings has been painted.
  let library = null;
  function loaded() {
    library ??= painted().then(() => inflated("plotly")).then((source) => {
      const script = document.createElement("script");
      script.textContent = source; // permitted by its hash in the policy of the page
      document.head.append(script);
      if (typeof Plotly === "undefined") throw new Error("plotly.js is not permitted");
      document.documentElement.dataset.library = String(Math.round(performance.now() - started));
    });
    return library;
  }

  const painted = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done, 0)));

  // Ready: the page can be read, and every figure is drawn as soon as it comes near.
  function start() {
    if (typeof DecompressionStream === "undefined" || !count) return;
    const near = new IntersectionObserver((entries) => {
      for (const entry of entries.filter((e) => e.isIntersecting)) {
        near.unobserve(entry.target);
        show(entry.target.id === "arm" ? scene : residuals, entry.target);
      }
    }, { rootMargin: "500px" });
    for (const id of ["arm", "residuals"]) {
      const section = document.getElementById(id);
      if (section) near.observe(section);
    }
    document.documentElement.dataset.ready = String(Math.round(performance.now() - started));
  }

  // A figure is drawn when its section comes near: what is not looked at costs nothing.
  async function show(figure, section) {
    let begun = performance.now();
    const holder = section.querySelector(".interactive"), still = section.querySelector(":scope > .static");
    try {
      await loaded();
      begun = performance.now();
      holder.hidden = false;
      await figure();
      if (still) still.hidden = true;
      section.dataset.drawn = String(Math.round(performance.now() - begun));
    } catch (error) { // no WebGL: the drawing stays
      holder.hidden = true;
      console.warn(`this browser cannot draw the figure of ${section.id}: ${error.message}`);
    }
  }

  start();
})();
