// Panel, slider, clock and camera. Runs last.
"use strict";

rollkane.run = () => {
  const element = (id) => document.getElementById(id);
  const data = JSON.parse(element("rollkane-data").textContent);
  const motion = new rollkane.Motion(data.frames);
  const box = rollkane.frame(motion, data.size);
  element("note").textContent = data.note;

  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({
      canvas: element("stage"),
      antialias: true,
      alpha: true,
    });
  } catch {
    element("note").textContent = "This browser cannot draw in three dimensions (WebGL).";
    return;
  }
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = THREE.PCFShadowMap;
  renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));

  const stage = new rollkane.Stage(data, motion, box);
  const camera = new THREE.PerspectiveCamera(32, 1, 1, 10);
  camera.up.set(0, 0, 1);
  const controls = new THREE.OrbitControls(camera, renderer.domElement);
  const clock = { elapsed: 0, playing: false, last: 0 };
  let asked = false;

  const draw = () => {
    // the depth range follows the camera: near things and far ones stay apart
    const distance = camera.position.distanceTo(controls.target);
    camera.near = distance / 100;
    camera.far = distance + 12 * box.radius;
    camera.updateProjectionMatrix();
    renderer.render(stage.scene, camera);
  };
  const ask = () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame((now) => {
      asked = false;
      advance(now);
    });
  };

  const show = () => {
    const state = motion.state(clock.elapsed);
    if (element("follow").checked) {
      const shift = new THREE.Vector3(...state.position).sub(stage.body.position);
      camera.position.add(shift);
      controls.target.add(shift);
      controls.update();
    }
    stage.show(state);
    rollkane.write(element, state);
    element("slider").value = clock.elapsed;
    ask();
  };
  const advance = (now) => {
    if (clock.playing) {
      const passed = Math.min((now - clock.last) / 1000, 0.2);
      clock.last = now;
      clock.elapsed += passed * Number(element("speed").value);
      if (clock.elapsed >= motion.duration) {
        clock.elapsed = motion.duration;
        play(false);
      }
      show();
    }
    draw();
  };
  const play = (on) => {
    if (on && clock.elapsed >= motion.duration) clock.elapsed = 0;
    clock.playing = on && motion.duration > 0;
    clock.last = performance.now();
    element("play").textContent = clock.playing ? "\u275a\u275a" : "\u25b6";
    show();
  };
  const look = () => {
    const slope = Math.tan((camera.fov * Math.PI) / 360);
    const [across, high, deep] = element("follow").checked
      ? box.half.map((x) => Math.min(x, 4 * data.size))
      : box.half;
    const distance = deep + Math.max(high, across / camera.aspect) / (0.8 * slope);
    const target = element("follow").checked ? stage.body.position.toArray() : box.center;
    controls.target.set(...target);
    camera.position.set(...target.map((x, i) => x + distance * box.eye[i]));
    controls.minDistance = 0.5 * data.size;
    controls.maxDistance = 12 * box.radius;
    controls.update();
    ask();
  };
  const resize = () => {
    const { clientWidth, clientHeight } = renderer.domElement;
    renderer.setSize(clientWidth, clientHeight, false);
    camera.aspect = clientWidth / Math.max(clientHeight, 1);
    camera.updateProjectionMatrix();
    ask();
  };
  const jump = (elapsed) => {
    clock.elapsed = Math.min(Math.max(elapsed, 0), motion.duration);
    play(false);
  };
  // "#frame=N" stops there, "&follow", "&force" switch these on
  const obey = () => {
    const wish = new URLSearchParams(window.location.hash.slice(1));
    for (const name of ["follow", "force"]) {
      if (wish.has(name)) element(name).checked = wish.get(name) !== "0";
    }
    stage.arrow.parts.forEach(({ pair }) =>
      pair.forEach((part) => { part.visible = element("force").checked; }));
    const frame = Number(wish.get("frame"));
    if (!wish.has("frame") || !Number.isInteger(frame)) return false;
    jump(motion.elapsed(Math.min(Math.max(frame, 0), motion.count - 1)));
    return true;
  };

  rollkane.listen({ element, stage, motion, clock, show, play, jump, look, ask, obey });
  rollkane.speeds(element("speed"), motion.duration);
  element("slider").max = motion.duration;
  element("grid-row").hidden = stage.spacing === 0;
  const [factor, unit] = stage.spacing < 0.1 ? [1000, "mm"] : [1, "m"];
  element("grid").textContent = String(Number((factor * stage.spacing).toPrecision(3)));
  element("grid-unit").textContent = unit;
  element("follow").checked = box.radius > 15 * data.size;
  controls.addEventListener("change", ask);
  window.addEventListener("resize", resize);

  stage.show(motion.state(0));
  resize();
  const still = obey();
  look();
  const calm = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (!still) play(!calm);
  draw();
};

rollkane.listen = ({ element, stage, motion, clock, show, play, jump, look, ask, obey }) => {
  const switched = (id, action) =>
    element(id).addEventListener("change", (event) => {
      action(event.target.checked);
      ask();
    });
  switched("force", (on) =>
    stage.arrow.parts.forEach(({ pair }) => pair.forEach((part) => { part.visible = on; })));
  switched("traces", (on) => {
    stage.onBase.group.visible = on;
    stage.onBody.group.visible = on;
  });
  switched("follow", look);
  element("reset").addEventListener("click", look);
  element("play").addEventListener("click", () => play(!clock.playing));
  element("slider").addEventListener("input", (event) => {
    clock.elapsed = Number(event.target.value);
    show();
  });
  window.addEventListener("hashchange", obey);
  window.addEventListener("keydown", (event) => {
    if (event.target.matches("select, input, button")) return;
    const frame = motion.locate(clock.elapsed).low;
    if (event.key === " ") play(!clock.playing);
    else if (event.key === "ArrowRight") jump(motion.elapsed(Math.min(frame + 1, motion.count - 1)));
    else if (event.key === "ArrowLeft") jump(motion.elapsed(Math.max(frame - 1, 0)));
    else return;
    event.preventDefault();
  });
};

// What the camera has to hold: the motion with the body round it, measured to the right,
// upwards and towards the eye; and from where it is seen best: from the side to which
// the base shows.
rollkane.frame = (motion, size) => {
  const facing = [0, 0, 0];
  for (let k = 0; k < motion.count; k += 1) {
    motion.row("outward", k).forEach((x, i) => { facing[i] += x / motion.count; });
  }
  const across = Math.hypot(facing[0], facing[1]);
  const turn = (across > 0.1 ? Math.atan2(facing[1], facing[0]) : -Math.PI / 2) + 0.45;
  const lift = Math.min(Math.max(Math.atan2(facing[2], across), 0.15), 0.62);
  const [c, s, C, S] = [Math.cos(lift), Math.sin(lift), Math.cos(turn), Math.sin(turn)];
  const eye = [c * C, c * S, s];
  const axes = [[-S, C, 0], [-s * C, -s * S, c], eye];
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let k = 0; k < motion.count; k += 1) {
    const point = motion.row("position", k);
    axes.forEach((axis, i) => {
      const along = axis.reduce((sum, x, j) => sum + x * point[j], 0);
      low[i] = Math.min(low[i], along - size);
      high[i] = Math.max(high[i], along + size);
    });
  }
  const half = low.map((x, i) => 0.5 * (high[i] - x));
  const middle = low.map((x, i) => x + half[i]);
  const center = [0, 1, 2].map((j) => axes.reduce((sum, axis, i) => sum + middle[i] * axis[j], 0));
  return { center, half, radius: Math.hypot(...half), eye };
};

rollkane.write = (element, state) => {
  const fixed = (x, digits) => (Number.isFinite(x) ? x.toFixed(digits) : "\u2013");
  const scientific = (x) => (Number.isFinite(x) ? x.toExponential(1) : "\u2013");
  element("time").textContent = fixed(state.time, 3);
  element("spin").textContent = fixed(state.spin, 3);
  element("normal-force").textContent = fixed(state.normalForce, 3);
  element("normal-force").className = state.normalForce < 0 ? "pulls" : "";
  const { energy } = state;
  element("energy-error").textContent = energy === 0 ? "0" : scientific(energy);
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
