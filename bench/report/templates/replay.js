"use strict";
// Plays stored flights on a canvas. Everything that can be clicked is an element of the page
// (button, range, select), so keyboards and screen readers work without more.
const inkOf = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`);
const TRAIL = 2.0; // seconds
const VIEWS = { oblique: [0.6, 0.5], above: [0, Math.PI / 2], side: [0, 0] };

function decodeFlight(flight) {
  const bytes = Uint8Array.from(atob(flight.xyz), (c) => c.charCodeAt(0));
  const steps = new Int16Array(bytes.buffer);
  const pos = Float32Array.from(steps, (s) => (s === -32768 ? NaN : s * flight.unit));
  return { ...flight, pos };
}

class Replay {
  constructor(root) {
    const part = (name) => root.querySelector(`[data-part=${name}]`);
    this.root = root;
    this.canvas = part("canvas");
    this.button = part("play");
    this.slider = part("time");
    this.readout = part("readout");
    this.speed = part("speed");
    this.view = part("view");
    this.trails = part("trails");
    this.flight = null;
    this.playing = false;
    [this.yaw, this.tilt] = VIEWS.oblique;
    this.button.addEventListener("click", () => this.toggle());
    this.slider.addEventListener("input", () => { this.stop(); this.seek(Number(this.slider.value)); });
    this.trails.addEventListener("change", () => this.draw());
    this.view.addEventListener("change", () => {
      [this.yaw, this.tilt] = VIEWS[this.view.value];
      this.draw();
    });
    this.canvas.addEventListener("pointerdown", (event) => this.canvas.setPointerCapture(event.pointerId));
    this.canvas.addEventListener("pointermove", (event) => {
      if (!event.buttons) return;
      this.yaw += event.movementX * 0.01;
      this.tilt = Math.min(Math.PI / 2, Math.max(0, this.tilt + event.movementY * 0.01));
      this.draw();
    });
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  show(flight) {
    this.stop();
    this.flight = decodeFlight(flight);
    const { t, drones } = this.flight;
    this.slider.min = t[0];
    this.slider.max = t[t.length - 1];
    this.frame = boundingBox(this.flight);
    this.canvas.setAttribute("aria-label",
      `Flight of ${drones.length} drones over ${(t[t.length - 1] - t[0]).toFixed(1)} seconds`);
    this.seek(t[0]);
  }

  toggle() {
    if (this.playing) { this.stop(); return; }
    if (this.now >= Number(this.slider.max)) this.seek(Number(this.slider.min));
    this.playing = true;
    this.button.textContent = "Pause";
    let before = null;
    const tick = (stamp) => {
      if (!this.playing) return;
      if (before !== null) this.seek(this.now + ((stamp - before) / 1000) * Number(this.speed.value));
      before = stamp;
      if (this.now >= Number(this.slider.max)) this.stop();
      else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  stop() {
    this.playing = false;
    this.button.textContent = "Play";
  }

  seek(time) {
    this.now = Math.min(Math.max(time, Number(this.slider.min)), Number(this.slider.max));
    this.slider.value = this.now;
    const state = this.at(this.now);
    const closest = state.closest === Infinity ? "-" : `${state.closest.toFixed(2)} m`;
    this.readout.textContent =
      `t = ${this.now.toFixed(1)} s, closest pair ${closest}, in contact: ${state.touching.size}`;
    this.slider.setAttribute("aria-valuetext", this.readout.textContent);
    this.draw();
  }

  // Positions at a time, linear between samples, and who is in contact then.
  at(time) {
    const { t, drones, pos, radius } = this.flight;
    let i = 0;
    while (i + 2 < t.length && t[i + 1] <= time) i++;
    const j = Math.min(i + 1, t.length - 1);
    const share = j > i ? (time - t[i]) / (t[j] - t[i]) : 0;
    const places = drones.map((_, d) => [0, 1, 2].map((k) => {
      const a = pos[(i * drones.length + d) * 3 + k];
      const b = pos[(j * drones.length + d) * 3 + k];
      return a + Math.min(Math.max(share, 0), 1) * (b - a);
    }));
    let closest = Infinity;
    const touching = new Set();
    places.forEach((p, a) => {
      if (time > 0.5 && p[2] <= 0) touching.add(a);
      for (let b = a + 1; b < places.length; b++) {
        const apart = Math.hypot(...p.map((x, k) => x - places[b][k]));
        if (apart < closest) closest = apart;
        if (apart < 2 * radius) { touching.add(a); touching.add(b); }
      }
    });
    return { places, closest, touching, index: i };
  }

  // Parallel projection: right and up on the canvas, and how far behind.
  project([x, y, z]) {
    const [cx, cy, cz] = this.frame.center;
    const right = (x - cx) * Math.cos(this.yaw) - (y - cy) * Math.sin(this.yaw);
    const behind = (x - cx) * Math.sin(this.yaw) + (y - cy) * Math.cos(this.yaw);
    const up = (z - cz) * Math.cos(this.tilt) + behind * Math.sin(this.tilt);
    const depth = behind * Math.cos(this.tilt) - (z - cz) * Math.sin(this.tilt);
    return [this.width / 2 + right * this.scale, this.height / 2 - up * this.scale, depth];
  }

  draw() {
    if (!this.flight || !this.canvas.clientWidth) return;
    const ratio = window.devicePixelRatio || 1;
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    this.canvas.width = this.width * ratio;
    this.canvas.height = this.height * ratio;
    this.scale = this.fit();
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.clearRect(0, 0, this.width, this.height);
    this.drawGround(pen);
    const { places, touching, index } = this.at(this.now);
    if (this.trails.checked) places.forEach((place, d) => this.drawTrail(pen, d, index, place));
    places.map((place, d) => ({ place, d, screen: this.project(place) }))
      .filter(({ place }) => place.every(Number.isFinite))
      .sort((a, b) => b.screen[2] - a.screen[2])
      .forEach(({ place, d, screen }) => this.drawDrone(pen, place, d, screen, touching.has(d)));
  }

  // Pixels per metre at which the whole box can be seen.
  fit() {
    const { ground, high } = this.frame;
    this.scale = 1;
    const corners = [0, 1, 2, 3].map((i) => this.project([ground[i & 1][0], ground[i >> 1][1], 0]));
    const span = (k) => Math.max(...corners.map((c) => c[k])) - Math.min(...corners.map((c) => c[k]));
    const tall = span(1) + high * Math.cos(this.tilt);
    return 0.92 * Math.min(this.width / span(0), this.height / tall);
  }

  drawGround(pen) {
    const [[x0, y0], [x1, y1]] = this.frame.ground;
    const step = this.frame.grid;
    pen.strokeStyle = inkOf("line");
    pen.lineWidth = 1;
    pen.beginPath();
    const line = (a, b) => {
      pen.moveTo(...this.project(a).slice(0, 2));
      pen.lineTo(...this.project(b).slice(0, 2));
    };
    for (let x = x0; x <= x1 + 1e-9; x += step) line([x, y0, 0], [x, y1, 0]);
    for (let y = y0; y <= y1 + 1e-9; y += step) line([x0, y, 0], [x1, y, 0]);
    pen.stroke();
    pen.fillStyle = inkOf("soft");
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "left";
    pen.textBaseline = "alphabetic";
    pen.fillText(`floor grid: ${step} m`, 10, this.height - 10);
    pen.strokeStyle = inkOf("soft");
    pen.beginPath();
    line([x0, y0, 0], [x0 + step, y0, 0]);
    line([x0, y0, 0], [x0, y0 + step, 0]);
    pen.stroke();
    for (const [name, at] of [["x", [x0 + 1.2 * step, y0, 0]], ["y", [x0, y0 + 1.2 * step, 0]]]) {
      pen.fillText(name, ...this.project(at).slice(0, 2));
    }
  }

  drawTrail(pen, d, index, place) {
    const { t, drones, pos } = this.flight;
    pen.strokeStyle = colorOf(d);
    pen.lineWidth = 1.5;
    pen.globalAlpha = 0.55;
    pen.beginPath();
    let drawing = false;
    for (let i = index; i >= 0 && t[i] > this.now - TRAIL; i--) {
      const from = (i * drones.length + d) * 3;
      const point = [pos[from], pos[from + 1], pos[from + 2]];
      if (!point.every(Number.isFinite)) { drawing = false; continue; }
      if (!drawing) pen.moveTo(...this.project(i === index && place.every(Number.isFinite) ? place : point).slice(0, 2));
      pen.lineTo(...this.project(point).slice(0, 2));
      drawing = true;
    }
    pen.stroke();
    pen.globalAlpha = 1;
  }

  drawDrone(pen, place, d, [x, y], touching) {
    const [fx, fy] = this.project([place[0], place[1], 0]);
    pen.strokeStyle = inkOf("soft");
    pen.lineWidth = 1;
    pen.beginPath();
    pen.moveTo(x, y);
    pen.lineTo(fx, fy);
    pen.stroke();
    const size = Math.max(6, this.flight.radius * this.scale);
    pen.fillStyle = colorOf(d);
    pen.beginPath();
    pen.arc(x, y, size, 0, 2 * Math.PI);
    pen.fill();
    if (touching) {
      pen.strokeStyle = inkOf("bad");
      pen.lineWidth = 4;
      pen.stroke();
    }
    pen.fillStyle = "#ffffff";
    pen.font = `600 ${Math.min(14, Math.max(8, size))}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillText(this.flight.drones[d], x, y);
  }
}

function colorOf(d) {
  return `hsl(${(205 + 137.5 * d) % 360} 65% 36%)`;
}

// What the canvas shows: all but the farthest half per cent of positions, and the floor.
function boundingBox({ pos, radius }) {
  const bound = [0, 1, 2].map((k) => {
    const own = pos.filter((x, i) => i % 3 === k && Number.isFinite(x)).sort();
    if (!own.length) return [0, 0];
    const at = (share) => own[Math.round(share * (own.length - 1))];
    return [at(0.005) - 2 * radius, at(0.995) + 2 * radius];
  });
  bound[2][0] = Math.min(bound[2][0], 0);
  const across = Math.max(bound[0][1] - bound[0][0], bound[1][1] - bound[1][0], 1);
  const grid = [1, 2, 5, 10, 20, 50, 100, 200, 500].find((step) => across / step <= 12) ?? 1000;
  const low = [0, 1].map((k) => Math.floor(bound[k][0] / grid) * grid);
  const high = [0, 1].map((k) => Math.ceil(bound[k][1] / grid) * grid);
  return {
    center: [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (bound[2][0] + bound[2][1]) / 2],
    ground: [low, high],
    grid,
    high: Math.max(bound[2][1] - bound[2][0], 0.5),
  };
}
