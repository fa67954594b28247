// Panel, slider, clock and camera. Runs when all other parts are there.
"use strict";

// Finds an element of the page by its name.
rollkane.element = (id) => document.getElementById(id);

rollkane.Player = class {
  constructor(data, renderer) {
    this.data = data;
    this.size = data.size;
    this.title = data.title || "motion";
    this.motion = new rollkane.Motion(data.frames);
    this.box = rollkane.frame(this.motion, rollkane.corners(data));
    this.stage = new rollkane.Stage(data, this.motion, this.box);
    this.renderer = renderer;
    this.camera = new THREE.PerspectiveCamera(32, 1, 1, 10);
    this.camera.up.set(0, 0, 1);
    this.controls = new THREE.OrbitControls(this.camera, renderer.domElement);
    this.elapsed = 0; // seconds of the motion since its first frame
    this.playing = false;
    this.last = 0; // when the picture before was drawn [ms]
    this.asked = false; // whether a picture is on its way
  }

  get follows() {
    return rollkane.element("follow").checked;
  }

  draw() {
    // the depth range follows the camera: near things and far ones stay apart
    const distance = this.camera.position.distanceTo(this.controls.target);
    this.camera.near = distance / 100;
    this.camera.far = distance + 12 * this.box.radius;
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld();
    this.stage.arrows.fit(this.camera);
    this.renderer.render(this.stage.scene, this.camera);
    rollkane.writeArrows(this);
  }

  ask() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame((now) => {
      this.asked = false;
      this.advance(now);
      this.draw();
      if (this.recorder) this.recorder.frame();
    });
  }

  advance(now) {
    if (!this.playing) return;
    // a picture that was begun before the clock was set going counts nothing
    const passed = Math.min(Math.max((now - this.last) / 1000, 0), 0.2);
    this.last = Math.max(now, this.last);
    this.elapsed += passed * Number(rollkane.element("speed").value);
    if (this.elapsed < this.motion.duration) this.show();
    else this.jump(this.motion.duration);
    if (this.recorder) this.ask();
  }

  // Put everything where it is at the present time.
  show() {
    const state = this.motion.state(this.elapsed);
    if (this.follows) {
      const shift = new THREE.Vector3(...state.position).sub(this.stage.body.position);
      this.camera.position.add(shift);
      this.controls.target.add(shift);
      this.controls.update();
    }
    this.stage.show(state);
    rollkane.write(state);
    rollkane.element("slider").value = this.elapsed;
    if (this.timeline) this.timeline.show();
    this.ask();
  }

  play(on) {
    if (on && this.elapsed >= this.motion.duration) this.elapsed = 0;
    this.playing = on && this.motion.duration > 0;
    this.last = performance.now();
    rollkane.element("play").textContent = this.playing ? "\u275a\u275a" : "\u25b6";
    this.show();
  }

  jump(elapsed) {
    this.elapsed = Math.min(Math.max(elapsed, 0), this.motion.duration);
    this.play(false);
  }

  jumpToFrame(frame) {
    this.jump(this.motion.elapsed(Math.min(Math.max(frame, 0), this.motion.count - 1)));
  }

  // Show another motion: of the same bodies, or, where meshes come with it, of others.
  replace(data) {
    this.data = { ...this.data, ...data };
    this.motion = new rollkane.Motion(data.frames);
    this.size = this.data.size;
    if ("body" in data) {
      this.stage = new rollkane.Stage(this.data, this.motion, this.box);
    } else {
      this.stage.replaceMotion(this.motion, data);
    }
    rollkane.element("note").textContent = data.note;
    rollkane.element("slider").max = this.motion.duration;
    this.elapsed = Math.min(this.elapsed, this.motion.duration);
    this.timeline.replace(this.motion, data);
    this.switched();
    this.show();
  }

  // Look at all of the motion, or, while following, at the body.
  look() {
    const { box, camera, controls } = this;
    const slope = Math.tan((camera.fov * Math.PI) / 360);
    const [across, high, deep] = this.follows
      ? box.half.map((x) => Math.min(x, 4 * this.size))
      : box.half;
    const { clientWidth, clientHeight } = this.renderer.domElement;
    const room = Math.max(clientWidth - this.covered, 1) / Math.max(clientHeight, 1);
    const distance = deep + Math.max(high, across / room) / (0.76 * slope);
    const target = this.follows ? this.stage.body.position.toArray() : box.center;
    controls.target.set(...target);
    camera.position.set(...target.map((x, i) => x + distance * box.eye[i]));
    controls.minDistance = 0.5 * this.size;
    controls.maxDistance = 12 * box.radius;
    controls.update();
    this.ask();
  }

  // Width of the picture that the panel lies over [px], not more than two fifths.
  get covered() {
    const panel = rollkane.element("panel");
    if (getComputedStyle(panel).position !== "fixed" || !panel.open) return 0;
    const { clientWidth } = this.renderer.domElement;
    return Math.min(panel.getBoundingClientRect().right, 0.4 * clientWidth);
  }

  resize() {
    const { clientWidth, clientHeight } = this.renderer.domElement;
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.camera.aspect = clientWidth / Math.max(clientHeight, 1);
    // the middle of the picture is that of the part that is seen
    const shift = -0.5 * this.covered;
    this.camera.setViewOffset(clientWidth, clientHeight, shift, 0, clientWidth, clientHeight);
    this.camera.updateProjectionMatrix();
    this.ask();
  }

  // Show what the switches say.
  switched() {
    const on = (id) => rollkane.element(id).checked;
    const { stage, timeline } = this;
    for (const name of rollkane.ARROWS) stage.arrows.shown[name] = on(name);
    stage.onBase.group.visible = stage.onBody.group.visible = on("traces");
    stage.ghosts.group.visible = on("ghosts");
    if (timeline.tall !== on("graph")) {
      timeline.tall = on("graph");
      timeline.prepare();
    }
    this.ask();
  }

  // Behind the page's name: "#frame=N" stops there, "&follow", "&force", "&axes" and so
  // on switch these on, "&graph=0" off.
  // Returns whether a frame was asked for.
  obey() {
    const wish = new URLSearchParams(window.location.hash.slice(1));
    for (const name of ["follow", "traces", "ghosts", "graph", ...rollkane.ARROWS]) {
      if (wish.has(name)) rollkane.element(name).checked = wish.get(name) !== "0";
    }
    this.switched();
    const frame = Number(wish.get("frame"));
    if (!wish.has("frame") || !Number.isInteger(frame)) return false;
    this.jumpToFrame(frame);
    return true;
  }
};

rollkane.ARROWS = ["force", "gravity", "omega", "axes"];

rollkane.renderer = () => {
  const canvas = rollkane.element("stage");
  try {
    const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
    renderer.shadowMap.enabled = true;
    renderer.shadowMap.type = THREE.PCFShadowMap;
    renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    return renderer;
  } catch {
    return null;
  }
};

rollkane.run = () => {
  const { element } = rollkane;
  const data = JSON.parse(element("rollkane-data").textContent);
  element("note").textContent = data.note;
  [element("energy-label").textContent, element("energy-unit").textContent] = data.energy_label;
  const renderer = rollkane.renderer();
  if (!renderer) {
    element("note").textContent = "This browser cannot draw in three dimensions (WebGL).";
    return;
  }
  const player = new rollkane.Player(data, renderer);
  const { motion, stage, box } = player;
  player.timeline = new rollkane.Timeline(
    player, data, element("timeline"), element("quantity"));
  player.recorder = new rollkane.Recorder(player, element("video"));
  rollkane.player = player; // for programs that look at the page
  element("slider").max = motion.duration;
  element("follow").checked = box.radius > 15 * data.size;
  element("ghosts-label").hidden = data.ghosts.length === 0;
  element("mode-row").hidden = !("mode" in motion.columns);
  element("graph").checked = window.innerHeight >= 560;
  element("panel").open = window.innerWidth > 720;
  rollkane.speeds(element("speed"), motion.duration);
  rollkane.writeGrid(stage.spacing);
  rollkane.listen(player);

  stage.show(motion.state(0));
  const still = player.obey();
  player.timeline.prepare();
  player.resize();
  player.look();
  const calm = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (!still) player.play(!calm);
  player.draw();
};

rollkane.listen = (player) => {
  const { element } = rollkane;
  const { motion } = player;
  for (const id of ["traces", "ghosts", "graph", ...rollkane.ARROWS]) {
    element(id).addEventListener("change", () => player.switched());
  }
  element("follow").addEventListener("change", () => player.look());
  element("reset").addEventListener("click", () => player.look());
  element("screenshot").addEventListener("click", () => rollkane.screenshot(player));
  element("video").addEventListener("click", () => player.recorder.toggle());
  element("play").addEventListener("click", () => player.play(!player.playing));
  element("slider").addEventListener("input", (event) => {
    player.elapsed = Number(event.target.value);
    player.show();
  });
  player.controls.addEventListener("change", () => player.ask());
  new ResizeObserver(() => player.resize()).observe(player.renderer.domElement);
  element("panel").addEventListener("toggle", () => player.resize());
  new ResizeObserver(() => player.timeline.prepare()).observe(element("bottom"));
  window.addEventListener("hashchange", () => player.obey());
  window.addEventListener("keydown", (event) => {
    const { target } = event;
    if (target.matches("select") || event.ctrlKey || event.altKey || event.metaKey) return;
    // what a button or a switch does with its own key
    if (event.key === " " && target.matches("button, summary, [type=checkbox]")) return;
    const frame = motion.locate(player.elapsed).low;
    if (event.key === " ") player.play(!player.playing);
    else if (event.key === "ArrowRight") player.jumpToFrame(frame + 1);
    else if (event.key === "ArrowLeft") player.jumpToFrame(frame - 1);
    else return;
    event.preventDefault();
  });
};

// Some points of the body, spread over all of it.
rollkane.corners = ({ body, size }) => {
  const points = body ? rollkane.points(body) : [size, size, size, -size, -size, -size];
  const step = 3 * Math.ceil(points.length / 600);
  const corners = [];
  for (let i = 0; i < points.length; i += step) {
    corners.push(new THREE.Vector3(points[i], points[i + 1], points[i + 2]));
  }
  return corners;
};

// What the camera has to hold: the motion with the body round it, measured to the right,
// upwards and towards the eye; and from where it is seen best: from the side to which
// the base shows.
rollkane.frame = (motion, corners) => {
  const facing = [0, 0, 0];
  for (let k = 0; k < motion.count; k += 1) {
    motion.row("outward", k).forEach((x, i) => { facing[i] += x / motion.count; });
  }
  const across = Math.hypot(facing[0], facing[1]);
  const turn = (across > 0.1 ? Math.atan2(facing[1], facing[0]) : -Math.PI / 2) + 0.45;
  const lift = Math.min(Math.max(Math.atan2(facing[2], across), 0.15), 0.62);
  const [c, s, C, S] = [Math.cos(lift), Math.sin(lift), Math.cos(turn), Math.sin(turn)];
  const eye = [c * C, c * S, s];
  const axes = [[-S, C, 0], [-s * C, -s * S, c], eye].map((v) => new THREE.Vector3(...v));
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let k = 0; k < motion.count; k += Math.ceil(motion.count / 200)) {
    const position = new THREE.Vector3(...motion.row("position", k));
    const [w, x, y, z] = motion.row("orientation", k);
    const turn = new THREE.Quaternion(x, y, z, w);
    for (const corner of corners) {
      const point = corner.clone().applyQuaternion(turn).add(position);
      axes.forEach((axis, i) => {
        const along = point.dot(axis);
        low[i] = Math.min(low[i], along);
        high[i] = Math.max(high[i], along);
      });
    }
  }
  const half = low.map((x, i) => 0.5 * (high[i] - x));
  const middle = low.map((x, i) => x + half[i]);
  const center = axes
    .reduce((sum, axis, i) => sum.addScaledVector(axis, middle[i]), new THREE.Vector3())
    .toArray();
  return { center, half, radius: Math.hypot(...half), eye };
};

rollkane.writeGrid = (spacing) => {
  const [factor, unit] = spacing < 0.1 ? [1000, "mm"] : [1, "m"];
  rollkane.element("grid").textContent = String(Number((factor * spacing).toPrecision(3)));
  rollkane.element("grid-unit").textContent = unit;
  rollkane.element("grid-row").hidden = spacing === 0;
};

rollkane.write = (state) => {
  const { element } = rollkane;
  const fixed = (x, digits) => (Number.isFinite(x) ? x.toFixed(digits) : "\u2013");
  const scientific = (x) => (Number.isFinite(x) ? x.toExponential(1) : "\u2013");
  element("time").textContent = fixed(state.time, 3);
  element("mode").textContent = rollkane.MODES[state.mode]?.[0] ?? "\u2013";
  element("spin").textContent = fixed(state.spin, 3);
  element("normal-force").textContent = fixed(state.normalForce, 3);
  element("normal-force").className = state.normalForce < 0 ? "pulls" : "";
  const { energy } = state;
  const error = element("energy-unit").textContent === "";
  const shown = error ? scientific(energy) : Number(energy.toPrecision(5)).toString();
  element("energy").textContent = energy === 0 ? "0" : shown;
};

// What arrows show, their scales and their names.
rollkane.writeArrows = ({ stage, camera }) => {
  const { element } = rollkane;
  const { arrows } = stage;
  const names = { force: "force", gravity: "gravity", omega: "angular velocity" };
  for (const [id, name] of Object.entries(names)) {
    const told = arrows.told(id);
    element(`${id}-told`).textContent = told && `${name} ${told}`;
  }
  element("labels").replaceChildren(...arrows.labels(camera).map(({ text, x, y }) => {
    const span = document.createElement("span");
    span.textContent = text;
    span.style.left = `${50 + 50 * x}%`;
    span.style.top = `${50 - 50 * y}%`;
    return span;
  }));
};

// Speeds round the one with which the motion is neither a flash nor a day.
rollkane.speeds = (select, duration) => {
  let usual = 1;
  if (duration > 0 && duration < 2) usual = rollkane.roundLength(duration / 2);
  if (duration > 120) usual = rollkane.roundLength(duration / 60);
  const factors = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10];
  const speeds = new Set([1, ...factors.map((x) => Number((x * usual).toPrecision(2)))]);
  for (const speed of [...speeds].sort((a, b) => a - b)) {
    const chosen = speed === Number(usual.toPrecision(2));
    select.add(new Option(`${speed}\u00d7`, String(speed), chosen, chosen));
  }
};

rollkane.run();
