"use strict";
// Interactive figures of the page, drawn from its own data. Nothing is fetched: plotly.js is inflated from
// the page. Where that is not possible, the drawings without script stay.
(() => {
  const started = performance.now();
  const data = JSON.parse(document.getElementById("data").textContent);
  const rows = data.rows, arm = data.arm, count = rows.id.length;
  // colours of the style sheet, which has a light and a dark scheme
  const scheme = matchMedia("(prefers-color-scheme: dark)");
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const INK = style("ink"), QUIET = style("quiet"), ACCENT = style("accent"), MARK = style("mark"), PALE = style("pale"), PAGE = style("page");
  const COLOURS = [ACCENT, style("check"), style("good"), scheme.matches ? "#c39bd8" : "#8e5ea2", "#5b8db8", scheme.matches ? "#d08a5b" : "#a0522d", INK, "#7b8794"];
  const SYMBOLS = ["circle", "diamond", "square", "circle-open", "diamond-open", "square-open"];
  const CONFIG = { displaylogo: false, responsive: true, modeBarButtonsToRemove: ["resetCameraLastSave3d", "lasso2d", "select2d"] };
  scheme.addEventListener("change", () => location.reload());
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

  const times = (m, v) => m.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
  const sum = (a, b) => a.map((v, k) => v + b[k]);
  const unit = (j) => arm.units ? arm.units[j] : "deg";
  // What moves with the joints up to each, at link angles (deg): each joint turns what follows it about its axis.
  function placed(angles) {
    let turn = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], shift = [0, 0, 0];
    const product = (a, b) => a.map((row) => [0, 1, 2].map((j) => row[0] * b[0][j] + row[1] * b[1][j] + row[2] * b[2][j]));
    const maker = (m, d) => (point) => sum(times(m, point), d);
    const out = [maker(turn, shift)];
    angles.forEach((angle, k) => {
      if (unit(k) === "mm") {  // it shifts what follows it
        shift = sum(times(turn, arm.axes[k].map((a) => a * angle)), shift);
        out.push(maker(turn, shift));
        return;
      }
      const [x, y, z] = arm.axes[k], c = Math.cos(radians(angle)), s = Math.sin(radians(angle)), v = 1 - c;
      const own = [[c + x * x * v, x * y * v - z * s, x * z * v + y * s],
        [y * x * v + z * s, c + y * y * v, y * z * v - x * s],
        [z * x * v - y * s, z * y * v + x * s, c + z * z * v]];
      const at = arm.links_mm[k + 1], moved = times(own, at);
      shift = sum(times(turn, at.map((a, i) => a - moved[i])), shift);
      turn = product(turn, own);
      out.push(maker(turn, shift));
    });
    return out;
  }

  // Points of the arm: the base, the joints, the flange.
  function pose(move) {
    return arm.links_mm.map((point, k) => move[Math.max(k - 1, 0)](point));
  }

  // A surface of rings about a segment; half spheres close its ends. Corners, and triangles of their numbers.
  const SIDES = 14, CAPS = 4;
  function capsule(a, b, radius) {
    const along = b.map((v, k) => v - a[k]), long = Math.hypot(...along);
    const z = long ? along.map((v) => v / long) : [0, 0, 1], first = Math.abs(z[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0];
    const cross = (u, v) => [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    const unit = (v) => v.map((c) => c / Math.hypot(...v)), x = unit(cross(first, z)), y = cross(z, x);
    const points = [], faces = [];
    for (const [end, from] of [[a, -90], [b, 0]]) for (let k = 0; k <= CAPS; k++) {
      const up = radians(from + 90 * k / CAPS), r = radius * Math.cos(up), h = radius * Math.sin(up);
      for (let j = 0; j < SIDES; j++) {
        const t = 2 * Math.PI * j / SIDES;
        points.push(end.map((v, i) => v + h * z[i] + r * (Math.cos(t) * x[i] + Math.sin(t) * y[i])));
      }
    }
    for (let k = 0; k < 2 * CAPS + 1; k++) for (let j = 0; j < SIDES; j++) {
      const p = k * SIDES + j, q = k * SIDES + (j + 1) % SIDES;
      faces.push([p, q, p + SIDES], [q, q + SIDES, p + SIDES]);
    }
    return { points, faces };
  }

  function box(centre, axes, half) {
    const signs = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => [k & 1 ? 1 : -1, k & 2 ? 1 : -1, k & 4 ? 1 : -1]);
    const points = signs.map((sign) => centre.map((v, i) => v + sign.reduce((total, s, k) => total + s * half[k] * axes[k][i], 0)));
    return { points, faces: [[0, 1, 3], [0, 3, 2], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 3, 7], [1, 7, 5]] };
  }

  // Several surfaces as one trace.
  function mesh(parts, color, flat) {
    const out = { type: "mesh3d", x: [], y: [], z: [], i: [], j: [], k: [], color, flatshading: flat, lighting: { ambient: 0.65, diffuse: 0.6, specular: 0.05 }, hoverinfo: "skip", showlegend: false };
    for (const { points, faces } of parts) {
      const start = out.x.length;
      for (const p of points) { out.x.push(p[0]); out.y.push(p[1]); out.z.push(p[2]); }
      for (const f of faces) { out.i.push(f[0] + start); out.j.push(f[1] + start); out.k.push(f[2] + start); }
    }
    return out;
  }

  const column = (points, axis) => points.map((p) => p[axis]);
  const said = (k) => rows.residual_um[k] === null ? "no residual" : `${rows.residual_um[k].toFixed(1)} µm`;
  function hover(k) {
    const lines = [`<b>${plain(rows.id[k])}</b>  ${said(k)}`, `${plain(rows.target[k])}, ${rows.role[k] === "validate" ? "validation" : "fitted"}`];
    if (rows.rejected[k]) lines.push("rejected as an outlier");
    if (rows.time_s) lines.push(`time ${(rows.time_s[k] / 60).toFixed(1)} min`);
    lines.push(arm.joints.map((_, j) => `J${j + 1} ${rows.joint[k][j].toFixed(1)}${arm.units ? ` ${unit(j)}` : ""}`).join(", ") + (arm.units ? "" : " deg"));
    return lines.join("<br>");
  }

  // What contacts can be coloured by: a number of each row, or a group of each row.
  const NUMBERS = {
    "size of the residual": { of: (k) => rows.residual_um[k] === null ? null : Math.abs(rows.residual_um[k]), unit: "|residual| (µm)", top: large },
    ...(rows.time_s ? { "time": { of: (k) => rows.time_s[k] / 60, unit: "time (min)" } } : {}),
    ...Object.fromEntries(arm.joints.map((_, j) => [`${unit(j) === "mm" ? "position" : "angle"} of J${j + 1}`, { of: (k) => rows.joint[k][j], unit: `J${j + 1} (${unit(j)})` }])),
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
      const marker = { size: shaped ? seen.map((k) => size * (0.75 + 0.75 * Math.min(Math.abs(rows.residual_um[k] ?? 0) / large, 1))) : size, color: seen.map((k) => values[k]), colorscale: "Cividis", reversescale: !scheme.matches,
        symbol: seen.map(shape), line: { width: 0.5, color: QUIET }, colorbar: { title: { text: unit, side: "right" }, thickness: 12, len: 0.8 } };
      if (top) Object.assign(marker, { cmin: 0, cmax: top });
      const out = [{ ...base(seen), marker }];
      if (rest.length) out.push({ ...base(rest), marker: { size: 0.7 * size, color: QUIET, symbol: "circle-open", line: { width: 0.5, color: QUIET } } });
      return out;
    }
    const groups = [...new Set(drawn.map(GROUPS[by]))];
    return groups.map((name, g) => {
      const some = drawn.filter((k) => GROUPS[by](k) === name), short = name.length > 28 ? name.slice(0, 27) + "…" : name;
      return { ...base(some), name: plain(short), showlegend: true, marker: { size, color: COLOURS[g % COLOURS.length], symbol: SYMBOLS[g % SYMBOLS.length], line: { width: 0.5, color: PAGE } } };
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
    const fixed = mesh((arm.artefacts ?? []).map((a) => a.half_mm ? box(a.centre_mm, a.axes, a.half_mm) : capsule(a.centre_mm, a.centre_mm, a.radius_mm)), style("mid"), true);
    const bodies = (k) => {
      const move = placed(rows.joint[k]), line = [...pose(move), rows.point_mm[k]], joints = line.slice(1, -2);
      const capsules = arm.capsules ?? [], thin = capsules.length > 0;
      const solid = mesh(capsules.map((c) => capsule(...c.ends_mm.map(move[c.joint]), c.radius_mm)), style("tool"), false);
      const links = { type: "scatter3d", mode: "lines", x: column(line, 0), y: column(line, 1), z: column(line, 2), line: { width: thin ? 2 : 9, color: "#8f9ba7" }, hoverinfo: "skip", showlegend: false };
      const nodes = { type: "scatter3d", mode: "markers+text", x: column(joints, 0), y: column(joints, 1), z: column(joints, 2), text: joints.map((_, j) => marked(j + 1) ? `<b>J${j + 1}</b>` : `J${j + 1}`), hovertext: arm.joints.map((name, j) => `joint ${j + 1}: ${plain(name)}`), hoverinfo: "text",
        textposition: "top center", textfont: { size: 11, color: joints.map((_, j) => marked(j + 1) ? MARK : INK) }, showlegend: false,
        marker: { size: joints.map((_, j) => marked(j + 1) ? 11 : 6), color: joints.map((_, j) => marked(j + 1) ? MARK : PAGE), line: { width: 2, color: INK } } };
      const red = { type: "scatter3d", mode: "lines", x: [], y: [], z: [], line: { width: 14, color: MARK }, hoverinfo: "skip", showlegend: false };
      const pieces = [...data.marks.links.map((j) => line.slice(j, j + 2)), ...(data.marks.tip ? [line.slice(-2)] : []), ...(data.marks.base ? [[line[0].map((v, a) => a === 0 ? v - length : v), line[0].map((v, a) => a === 0 ? v + length : v)]] : [])];
      for (const piece of pieces) for (const p of [...piece, [null, null, null]]) { red.x.push(p[0]); red.y.push(p[1]); red.z.push(p[2]); }
      return [links, nodes, red, solid];
    };
    const axis = (name) => ({ title: { text: `${name} (mm)` }, backgroundcolor: PAGE, gridcolor: PALE, zerolinecolor: PALE, showspikes: false, tickfont: { size: 10 } });
    const layout = { font: FONT, paper_bgcolor: PAGE, margin: { l: 0, r: 0, t: 0, b: 0 }, uirevision: "same", legend: { orientation: "h", y: 0, yanchor: "bottom" }, hoverlabel: { bgcolor: PAGE, font: FONT, align: "left" },
      scene: { aspectmode: "data", xaxis: axis("x"), yaxis: axis("y"), zaxis: axis("z"), uirevision: "same", camera: { eye: data.eye, up: { x: 0, y: 0, z: 1 } } } };
    let row = data.typical;
    const draw = () => Plotly.react(at, [...bodies(row), fixed, ...traces("scatter3d", { x: column(rows.point_mm, 0), y: column(rows.point_mm, 1), z: column(rows.point_mm, 2) }, colour.value, 5, true)], layout, CONFIG);
    const move = (k) => {
      row = k;
      slider.value = String(k);
      shown.textContent = `${rows.id[k]}, ${said(k)}`;
      const parts = bodies(k);
      for (const axis of ["x", "y", "z"]) Plotly.restyle(at, { [axis]: parts.map((p) => p[axis]) }, [0, 1, 2, 3]);
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
      const layout = { font: FONT, paper_bgcolor: PAGE, margin: { l: 60, r: 12, t: 8, b: text ? 90 : 48 }, hovermode: "closest", hoverlabel: { bgcolor: PAGE, font: FONT, align: "left" }, legend: { orientation: "h", y: 1.02, yanchor: "bottom" }, plot_bgcolor: PAGE,
        xaxis: { title: { text: x.unit }, gridcolor: PALE, zeroline: false, automargin: true, type: text ? "category" : "linear" }, yaxis: { title: { text: data.residual_label }, gridcolor: PALE, zerolinecolor: QUIET },
        shapes: noise === null ? [] : [{ type: "rect", xref: "paper", x0: 0, x1: 1, y0: data.signed ? -2 * noise : 0, y1: 2 * noise, fillcolor: style("band"), line: { width: 0 }, layer: "below" }] };
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
