// Plays the stored motion: one small stage for each figure, all seen by one camera and driven by one clock.
(() => {
  "use strict";
  const root = document.getElementById("viewer");
  if (!root) return;
  const part = name => document.getElementById(`viewer-${name}`);
  const read = name => JSON.parse(document.getElementById(`motion-${name}`).textContent);
  const { bodies } = read("index");
  const stage = part("stage"), slider = part("time"), face = part("clockface"), play = part("play");
  const still = matchMedia("(prefers-reduced-motion: reduce)");

  const PAUSE = 0.6;         // seconds that the last pose stays before the motion starts again
  const TURN = Math.PI / 180;
  const LOWEST = 0.01 * TURN, HIGHEST = 88 * TURN;

  const state = {
    clip: null, figures: [], hidden: new Set(),
    time: 0, total: 1, playing: false, wanted: false, speed: 1, visible: false, dirty: true, last: 0,
    yaw: 35 * TURN, pitch: 10 * TURN, zoom: 1, follow: true, phase: false,
    tall: 1, span: 1, middle: [0, 0], drawn: 0,
  };

  // ------------------------------------------------------------------ the clip

  function unpack(figure) {
    const text = atob(figure.data), bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    const steps = new DataView(bytes.buffer), count = bytes.length / 2;
    const values = new Float32Array(count);
    for (let i = 0; i < count; i++) values[i] = figure.corner[i % 3] + figure.step * steps.getUint16(2 * i, true);
    return values;
  }

  // Where the camera looks: the hips' place on the floor, without the sway of each step.
  function path(values, body, frames, fps) {
    const stride = 3 * body.points, reach = Math.round(0.4 * fps);
    const sum = new Float64Array(2 * (frames + 1));
    for (let f = 0; f < frames; f++) {
      sum[2 * f + 2] = sum[2 * f] + values[f * stride + 3 * body.hips];
      sum[2 * f + 3] = sum[2 * f + 1] + values[f * stride + 3 * body.hips + 2];
    }
    const smooth = new Float32Array(2 * frames);
    for (let f = 0; f < frames; f++) {
      // The same reach on both sides, so that the ends do not lag.
      const r = Math.min(reach, f, frames - 1 - f), n = 2 * r + 1;
      for (let k = 0; k < 2; k++) smooth[2 * f + k] = (sum[2 * (f + r + 1) + k] - sum[2 * (f - r) + k]) / n;
    }
    return smooth;
  }

  function load(number) {
    const clip = read(number);
    const figures = clip.figures.map(figure => {
      const body = bodies[figure.body], values = unpack(figure);
      return {
        ...figure, data: null, body, values, frames: figure.frames,
        seconds: (figure.frames - 1) / figure.fps,
        path: path(values, body, figure.frames, figure.fps),
        pose: new Float32Array(3 * body.points), seen: new Float32Array(4 * body.points), floor: [0, 0],
      };
    });
    let tall = 0;
    const room = [Infinity, -Infinity, Infinity, -Infinity];
    for (const figure of figures) {
      const heights = [];
      for (let i = 1; i < figure.values.length; i += 3 * figure.body.points) {
        let top = -Infinity;
        for (let p = 0; p < figure.body.points; p++) top = Math.max(top, figure.values[i + 3 * p]);
        heights.push(top);
      }
      heights.sort((a, b) => a - b);
      tall = Math.max(tall, heights[Math.floor(0.97 * (heights.length - 1))]);
      for (let i = 0; i < figure.path.length; i += 2) {
        room[0] = Math.min(room[0], figure.path[i]); room[1] = Math.max(room[1], figure.path[i]);
        room[2] = Math.min(room[2], figure.path[i + 1]); room[3] = Math.max(room[3], figure.path[i + 1]);
      }
    }
    Object.assign(state, {
      clip, figures, tall: Math.max(0.3, tall), time: 0,
      span: Math.hypot(room[1] - room[0], room[3] - room[2]), middle: [(room[0] + room[1]) / 2, (room[2] + room[3]) / 2],
    });
    const phased = figures.some(figure => figure.phase);
    part("clock").disabled = !phased;
    part("clock").title = phased ? "" : "No figure of this clip changes timing.";
    if (!phased) part("clock").value = "clock";
    state.phase = part("clock").value === "phase";
    part("missing").textContent = clip.missing.length
      ? `Not shown: ${clip.missing.map(row => `${row.label} (${row.reason})`).join("; ")}.` : "";
    build();
    measure();
  }

  // ------------------------------------------------------------------ the page's elements

  function build() {
    stage.replaceChildren(...state.figures.map(figure => {
      const box = document.createElement("figure"), canvas = document.createElement("canvas");
      const name = document.createElement("figcaption"), note = document.createElement("small");
      box.className = `actor ${figure.role}`;
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", `${figure.label}, moving`);
      // A long name breaks before its variant.
      figure.label.split(/(?=\[)/).forEach((piece, i) => name.append(...(i ? [document.createElement("wbr")] : []), piece));
      note.textContent = [figure.note, `${figure.seconds.toFixed(1)} s`].filter(Boolean).join(", ");
      name.append(note);
      box.append(canvas, name);
      Object.assign(figure, { box, canvas, pen: canvas.getContext("2d") });
      box.hidden = state.hidden.has(figure.method);
      return box;
    }));
    part("shown").replaceChildren(...state.figures.map(figure => {
      const label = document.createElement("label"), box = document.createElement("input");
      box.type = "checkbox";
      box.checked = !figure.box.hidden;
      box.addEventListener("change", () => {
        if (box.checked) state.hidden.delete(figure.method); else state.hidden.add(figure.method);
        figure.box.hidden = !box.checked;
        fit();
      });
      label.append(box, ` ${figure.label}`);
      return label;
    }));
    fit();
  }

  function measure() {
    state.total = state.phase
      ? state.clip.seconds
      : Math.max(...state.figures.map(figure => figure.seconds));
    state.total = Math.max(state.total, 1 / 30);
    slider.max = state.total.toFixed(3);
    slider.step = (1 / 30).toFixed(5);
    seek(Math.min(state.time, state.total));
  }

  function fit() {
    const dense = Math.min(3, devicePixelRatio || 1);
    for (const figure of state.figures) {
      const width = Math.round(figure.canvas.clientWidth * dense), height = Math.round(figure.canvas.clientHeight * dense);
      if (width && (figure.canvas.width !== width || figure.canvas.height !== height)) {
        figure.canvas.width = width;
        figure.canvas.height = height;
      }
    }
    state.dirty = true;
    wake();
  }

  // ------------------------------------------------------------------ colours

  let look = {};
  function mix(a, b, t) {
    const at = (hex, i) => parseInt(hex.slice(1 + 2 * i, 3 + 2 * i), 16);
    return `rgb(${[0, 1, 2].map(i => Math.round(at(a, i) + (at(b, i) - at(a, i)) * t)).join(" ")})`;
  }
  const tone = hex => ({ light: mix(hex, "#ffffff", 0.42), base: hex, dark: mix(hex, "#000000", 0.38) });
  function colours() {
    const style = getComputedStyle(document.documentElement);
    const get = name => style.getPropertyValue(`--${name}`).trim();
    look = {
      ground: get("ground"), line: get("ground-line"), shadow: get("shadow"), edge: get("limb-edge"),
      sides: [tone("#8b909c"), tone("#0072b2"), tone("#d55e00")], real: tone("#009e73"),
    };
    state.dirty = true;
    wake();
  }

  // ------------------------------------------------------------------ drawing

  const own = figure => {
    if (!state.phase || !figure.phase) return Math.min(state.time, figure.seconds);
    const at = Math.min(10 * state.time, figure.phase.length - 1), low = Math.floor(at);
    const high = Math.min(low + 1, figure.phase.length - 1);
    return Math.min((figure.phase[low] + (figure.phase[high] - figure.phase[low]) * (at - low)) / 1000, figure.seconds);
  };

  function pose(figure) {
    const at = own(figure) * figure.fps, low = Math.min(Math.floor(at), figure.frames - 1);
    const high = Math.min(low + 1, figure.frames - 1), share = at - low;
    const stride = 3 * figure.body.points, { values } = figure;
    for (let i = 0; i < stride; i++) {
      const a = values[low * stride + i];
      figure.pose[i] = a + (values[high * stride + i] - a) * share;
    }
    for (let k = 0; k < 2; k++) {
      figure.floor[k] = state.follow
        ? figure.path[2 * low + k] + (figure.path[2 * high + k] - figure.path[2 * low + k]) * share
        : state.middle[k];
    }
  }

  // A lens above the floor: gives place on the canvas, size of a metre there, and nearness.
  function lens(figure) {
    const { width, height } = figure.canvas;
    const room = state.follow ? 1.36 * state.tall : Math.max(1.36 * state.tall, 1.25 * (state.span + 0.6 * state.tall));
    const metre = state.zoom * Math.min(height, 1.25 * width) / room, away = 4.2 * room;
    const cy = Math.cos(state.yaw), sy = Math.sin(state.yaw), ct = Math.cos(state.pitch), st = Math.sin(state.pitch);
    const [tx, tz] = figure.floor, ty = 0.48 * state.tall;
    return (x, y, z, out, at) => {
      const dx = x - tx, dy = y - ty, dz = z - tz;
      const across = cy * dx - sy * dz, near = sy * dx + cy * dz;
      const depth = st * dy + ct * near, scale = metre * away / Math.max(0.1 * away, away - depth);
      out[at] = width / 2 + across * scale;
      out[at + 1] = height / 2 - (ct * dy - st * near) * scale;
      out[at + 2] = scale;
      out[at + 3] = depth;
    };
  }

  const spot = new Float32Array(4), spot2 = new Float32Array(4);

  function floor(figure, see) {
    const { pen } = figure, [cx, cz] = figure.floor;
    const radius = state.follow ? 0.58 * state.tall : 0.5 * state.span + 0.6 * state.tall;
    pen.beginPath();
    for (let i = 0; i <= 48; i++) {
      const turn = i / 24 * Math.PI;
      see(cx + radius * Math.cos(turn), 0, cz + radius * Math.sin(turn), spot, 0);
      pen.lineTo(spot[0], spot[1]);
    }
    pen.fillStyle = look.ground;
    pen.fill();
    return radius;
  }

  function grid(figure, see, radius) {
    const { pen } = figure, [cx, cz] = figure.floor, gap = radius > 3 ? 1 : 0.25;
    pen.beginPath();
    for (const [mine, other, swap] of [[cx, cz, false], [cz, cx, true]]) {
      for (let at = Math.ceil((mine - radius) / gap) * gap; at < mine + radius; at += gap) {
        const half = Math.sqrt(Math.max(0, radius * radius - (at - mine) ** 2));
        if (swap) { see(other - half, 0, at, spot, 0); see(other + half, 0, at, spot2, 0); }
        else { see(at, 0, other - half, spot, 0); see(at, 0, other + half, spot2, 0); }
        pen.moveTo(spot[0], spot[1]);
        pen.lineTo(spot2[0], spot2[1]);
      }
    }
    pen.strokeStyle = look.line;
    pen.lineWidth = Math.max(1, figure.canvas.width / 320);
    pen.stroke();
  }

  function shadow(figure, see) {
    const { pen, body, pose: p } = figure;
    const flat = Math.max(0.3, Math.sin(state.pitch));
    // The light stands a little to the side, so that the shadow leaves the feet when they leave the floor.
    const cast = (point, out) => {
      const y = Math.max(0, p[3 * point + 1]);
      see(p[3 * point] + 0.16 * y, 0, p[3 * point + 2] - 0.10 * y, out, 0);
    };
    pen.strokeStyle = pen.fillStyle = look.shadow;
    pen.lineCap = "round";
    for (const [a, b, ra, rb] of body.limbs) {
      cast(a, spot);
      cast(b, spot2);
      pen.beginPath();
      pen.lineWidth = Math.max(1, (ra + rb) / 1000 * spot[2] * flat);
      pen.moveTo(spot[0], spot[1]);
      pen.lineTo(spot2[0] + 0.01, spot2[1]);
      pen.stroke();
    }
    if (body.head) {
      cast(body.head[0], spot);
      cast(body.head[1], spot2);
      const r = body.head[2] / 1000 * spot[2];
      pen.beginPath();
      pen.ellipse((spot[0] + spot2[0]) / 2, (spot[1] + spot2[1]) / 2, r, r * flat, 0, 0, 2 * Math.PI);
      pen.fill();
    }
  }

  // The outline of two circles and what lies between them.
  function taper(pen, x0, y0, r0, x1, y1, r1) {
    const d = Math.hypot(x1 - x0, y1 - y0);
    pen.beginPath();
    if (d <= Math.abs(r0 - r1) + 1e-3) {
      if (r0 > r1) pen.arc(x0, y0, r0, 0, 2 * Math.PI); else pen.arc(x1, y1, r1, 0, 2 * Math.PI);
      return;
    }
    const along = Math.atan2(y1 - y0, x1 - x0), open = Math.acos((r0 - r1) / d);
    pen.arc(x0, y0, r0, along + open, along - open + 2 * Math.PI);
    pen.arc(x1, y1, r1, along - open, along + open);
    pen.closePath();
  }

  // From the lit side of a line to the other; the light comes from the upper left.
  function shade(pen, x0, y0, x1, y1, reach, tones) {
    const d = Math.hypot(x1 - x0, y1 - y0) || 1;
    let nx = -(y1 - y0) / d, ny = (x1 - x0) / d;
    if (nx * -0.55 + ny * -0.83 < 0) { nx = -nx; ny = -ny; }
    const mx = (x0 + x1) / 2, my = (y0 + y1) / 2;
    const paint = pen.createLinearGradient(mx + nx * reach, my + ny * reach, mx - nx * reach, my - ny * reach);
    paint.addColorStop(0, tones.base);
    paint.addColorStop(0.28, tones.light);
    paint.addColorStop(0.6, tones.base);
    paint.addColorStop(1, tones.dark);
    return paint;
  }

  function trunk(figure, seen, tones) {
    const { pen, body } = figure;
    const parts = body.limbs.filter(limb => limb[5]);
    if (!parts.length) return;
    const [a, b] = parts[0];
    let reach = 0;
    const d = Math.hypot(seen[4 * b] - seen[4 * a], seen[4 * b + 1] - seen[4 * a + 1]) || 1;
    const nx = -(seen[4 * b + 1] - seen[4 * a + 1]) / d, ny = (seen[4 * b] - seen[4 * a]) / d;
    for (const [p, q, rp, rq] of parts) {
      for (const [point, r] of [[p, rp], [q, rq]]) {
        const off = Math.abs((seen[4 * point] - seen[4 * a]) * nx + (seen[4 * point + 1] - seen[4 * a + 1]) * ny);
        reach = Math.max(reach, off + r / 1000 * seen[4 * point + 2]);
      }
    }
    for (const pass of [0, 1]) {
      if (pass) pen.fillStyle = shade(pen, seen[4 * a], seen[4 * a + 1], seen[4 * b], seen[4 * b + 1], reach, tones);
      for (const [p, q, rp, rq] of parts) {
        taper(pen, seen[4 * p], seen[4 * p + 1], rp / 1000 * seen[4 * p + 2], seen[4 * q], seen[4 * q + 1], rq / 1000 * seen[4 * q + 2]);
        if (pass) pen.fill(); else pen.stroke();
      }
      if (pass) {
        // The waist between the flanks and the middle.
        pen.beginPath();
        for (const [p, q] of [[parts[1][0], parts[1][1]], [parts[2][1], parts[2][0]]]) {
          pen.lineTo(seen[4 * p], seen[4 * p + 1]);
          pen.lineTo(seen[4 * q], seen[4 * q + 1]);
        }
        pen.closePath();
        pen.fill();
      }
    }
  }

  function head(figure, seen, tones) {
    const { pen, body } = figure, [a, b, mm] = body.head;
    const x = (seen[4 * a] + seen[4 * b]) / 2, y = (seen[4 * a + 1] + seen[4 * b + 1]) / 2;
    const r = mm / 1000 * seen[4 * a + 2];
    const dx = seen[4 * b] - seen[4 * a], dy = seen[4 * b + 1] - seen[4 * a + 1], d = Math.hypot(dx, dy);
    pen.beginPath();
    pen.ellipse(x, y, Math.max(r, r + 0.1 * d), r, d > 1e-3 ? Math.atan2(dy, dx) : 0, 0, 2 * Math.PI);
    pen.stroke();
    const paint = pen.createRadialGradient(x - 0.35 * r, y - 0.45 * r, 0.1 * r, x, y, 1.25 * r);
    paint.addColorStop(0, tones.light);
    paint.addColorStop(0.55, tones.base);
    paint.addColorStop(1, tones.dark);
    pen.fillStyle = paint;
    pen.fill();
  }

  function drawFigure(figure) {
    const { pen, body, canvas, seen } = figure;
    if (!canvas.width) return;
    pose(figure);
    const see = lens(figure);
    pen.clearRect(0, 0, canvas.width, canvas.height);
    const radius = floor(figure, see);
    shadow(figure, see);
    grid(figure, see, radius);
    for (let i = 0; i < body.points; i++) see(figure.pose[3 * i], figure.pose[3 * i + 1], figure.pose[3 * i + 2], seen, 4 * i);
    const middle = figure.role === "real" ? look.real : look.sides[0];
    const order = [];
    let depth = 0, count = 0;
    for (const limb of body.limbs) {
      const at = (seen[4 * limb[0] + 3] + seen[4 * limb[1] + 3]) / 2;
      if (limb[5]) { depth += at; count++; } else order.push([at, limb]);
    }
    if (count) order.push([depth / count, "trunk"]);
    if (body.head) order.push([(seen[4 * body.head[0] + 3] + seen[4 * body.head[1] + 3]) / 2, "head"]);
    order.sort((p, q) => p[0] - q[0]);
    pen.strokeStyle = look.edge;
    pen.lineWidth = Math.max(1.5, canvas.width / 130);
    pen.lineJoin = "round";
    for (const [, what] of order) {
      if (what === "trunk") trunk(figure, seen, middle);
      else if (what === "head") head(figure, seen, middle);
      else {
        const [a, b, ra, rb, side] = what;
        const r0 = ra / 1000 * seen[4 * a + 2], r1 = rb / 1000 * seen[4 * b + 2];
        taper(pen, seen[4 * a], seen[4 * a + 1], r0, seen[4 * b], seen[4 * b + 1], r1);
        pen.stroke();
        pen.fillStyle = shade(pen, seen[4 * a], seen[4 * a + 1], seen[4 * b], seen[4 * b + 1], Math.max(r0, r1),
          side ? look.sides[side] : middle);
        pen.fill();
      }
    }
  }

  function draw() {
    for (const figure of state.figures) {
      if (figure.box.hidden) continue;
      drawFigure(figure);
      // Whoever is done while others still move stands back.
      const over = !state.phase && state.time > figure.seconds + 0.05;
      if (over !== figure.over) figure.box.classList.toggle("over", figure.over = over);
    }
    state.drawn++;
    root.dataset.frames = state.drawn;
    root.dataset.time = state.time.toFixed(3);
    root.dataset.turn = `${(state.yaw / TURN).toFixed(1)} ${(state.pitch / TURN).toFixed(1)} ${state.zoom.toFixed(2)}`;
    state.dirty = false;
  }

  // ------------------------------------------------------------------ the clock

  let waiting = 0;
  function wake() {
    if (!waiting) waiting = requestAnimationFrame(tick);
  }

  function tick(now) {
    waiting = 0;
    if (!state.visible) { state.last = 0; return; }
    if (state.playing) {
      // A tab that slept must not jump.
      const passed = state.last ? Math.min(0.1, (now - state.last) / 1000) : 0;
      state.last = now;
      state.held = state.time >= state.total ? (state.held || 0) + passed : 0;
      if (state.held > PAUSE) { state.time = 0; state.held = 0; }
      else state.time = Math.min(state.total, state.time + passed * state.speed);
      show();
    }
    if (state.playing || state.dirty) draw();
    if (state.playing) wake(); else state.last = 0;
  }

  function show() {
    slider.value = state.time;
    const words = `${state.time.toFixed(2)} s of ${state.total.toFixed(2)} s`;
    face.textContent = `${state.time.toFixed(2)} of ${state.total.toFixed(2)} s`;
    slider.setAttribute("aria-valuetext", words);
  }

  function seek(time) {
    state.time = Math.max(0, Math.min(state.total, time));
    state.held = 0;
    state.dirty = true;
    show();
    wake();
  }

  function setPlaying(on) {
    state.playing = on;
    state.last = 0;
    play.textContent = on ? "Pause" : "Play";
    wake();
  }

  // ------------------------------------------------------------------ what the viewer does

  function turn(yaw, pitch) {
    state.yaw += yaw * TURN;
    state.pitch = Math.max(LOWEST, Math.min(HIGHEST, state.pitch + pitch * TURN));
    part("view").value = "";
    state.dirty = true;
    wake();
  }
  function zoom(factor) {
    state.zoom = Math.max(0.4, Math.min(6, state.zoom * factor));
    state.dirty = true;
    wake();
  }
  function view(words) {
    if (!words) return;
    [state.yaw, state.pitch] = words.split(" ").map(value => Number(value) * TURN);
    state.dirty = true;
    wake();
  }
  function reset() {
    part("view").selectedIndex = 0;
    state.zoom = 1;
    view(part("view").value);
  }
  function toggle() { state.wanted = true; setPlaying(!state.playing); }
  function step(frames) { state.wanted = true; setPlaying(false); seek(state.time + frames / 30); }

  play.addEventListener("click", toggle);
  slider.addEventListener("input", () => { state.wanted = true; setPlaying(false); seek(Number(slider.value)); });
  part("speed").addEventListener("change", event => { state.speed = Number(event.target.value); });
  part("view").addEventListener("change", event => view(event.target.value));
  part("clock").addEventListener("change", event => { state.phase = event.target.value === "phase"; measure(); });
  part("follow").addEventListener("change", event => { state.follow = event.target.checked; state.dirty = true; wake(); });
  part("in").addEventListener("click", () => zoom(1.2));
  part("out").addEventListener("click", () => zoom(1 / 1.2));
  part("left").addEventListener("click", () => turn(-15, 0));
  part("right").addEventListener("click", () => turn(15, 0));
  part("reset").addEventListener("click", reset);
  part("clip").addEventListener("change", event => {
    load(event.target.value);
    part("status").textContent = `${state.clip.title}: ${state.figures.length} figures, ${state.total.toFixed(1)} seconds.`;
  });

  const keys = {
    " ": toggle, ArrowLeft: () => turn(-5, 0), ArrowRight: () => turn(5, 0), ArrowUp: () => turn(0, 5), ArrowDown: () => turn(0, -5),
    "+": () => zoom(1.1), "=": () => zoom(1.1), "-": () => zoom(1 / 1.1), ",": () => step(-1), ".": () => step(1), Home: reset,
  };
  stage.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey || !(event.key in keys)) return;
    event.preventDefault();
    keys[event.key]();
  });

  const pointers = new Map();
  stage.addEventListener("pointerdown", event => {
    if (event.button) return;
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    stage.setPointerCapture(event.pointerId);
    stage.classList.add("turning");
  });
  stage.addEventListener("pointermove", event => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    if (pointers.size === 1) turn((now[0] - before[0]) * -0.5, (now[1] - before[1]) * 0.35);
    else {
      const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
      const apart = point => Math.hypot(point[0] - other[0], point[1] - other[1]);
      zoom(apart(now) / Math.max(1, apart(before)));
    }
    pointers.set(event.pointerId, now);
  });
  for (const name of ["pointerup", "pointercancel"]) {
    stage.addEventListener(name, event => {
      pointers.delete(event.pointerId);
      if (!pointers.size) stage.classList.remove("turning");
    });
  }
  stage.addEventListener("wheel", event => {
    if (!event.ctrlKey) return;
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 300));
  }, { passive: false });

  new ResizeObserver(fit).observe(stage);
  new IntersectionObserver(entries => {
    state.visible = entries[entries.length - 1].isIntersecting;
    // Plays by itself once it is seen, unless motion is unwelcome or somebody has taken the controls.
    if (state.visible && !state.wanted && !still.matches) { state.wanted = true; setPlaying(true); }
    state.dirty = true;
    state.last = 0;
    wake();
  }, { threshold: 0.05 }).observe(stage);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", colours);
  colours();
  load(part("clip").value);
})();
