// What is drawn beside the bodies: traces, arrows with their scales, ghosts.
"use strict";

var rollkane = rollkane || {};

// A path that can be shown up to a frame and a point beyond it.
rollkane.Trace = class {
  constructor(points, color) {
    // a path that winds much in little room is drawn thinner
    const steps = points.slice(1).map((p, k) => Math.hypot(...p.map((x, i) => x - points[k][i])));
    const extents = [0, 1, 2].map((i) => {
      const values = points.map((p) => p[i]);
      return Math.max(...values) - Math.min(...values);
    });
    const winding = steps.reduce((sum, x) => sum + x, 0) / Math.max(...extents, 1e-300);
    const width = Math.min(Math.max(12 / Math.sqrt(winding), 1.2), 3);
    const line = (flat) => {
      const geometry = new THREE.LineGeometry();
      geometry.setPositions(flat);
      const material = new THREE.LineMaterial({ color, linewidth: width });
      const object = new THREE.Line2(geometry, material);
      object.frustumCulled = false;
      object.renderOrder = 1;
      return object;
    };
    this.points = points;
    this.line = line(points.flat());
    this.head = line([...points[0], ...points[0]]);
    this.group = new THREE.Group();
    this.group.add(this.line, this.head);
  }

  dispose() {
    for (const { geometry, material } of [this.line, this.head]) {
      geometry.dispose();
      material.dispose();
    }
  }

  show(frame, point) {
    this.line.geometry.instanceCount = frame;
    this.line.visible = frame > 0;
    this.head.geometry.setPositions([...this.points[frame], ...point]);
  }
};

// An arrow of a vector, seen faintly through bodies.
rollkane.Arrow = class {
  constructor(size, color, thin = 1) {
    this.group = new THREE.Group();
    this.size = size;
    this.parts = [0.35, 1].map((opacity) => {
      const material = new THREE.MeshBasicMaterial({
        color,
        opacity,
        transparent: opacity < 1,
        depthTest: opacity === 1,
      });
      const shaft = new THREE.CylinderGeometry(
        0.018 * thin * size, 0.018 * thin * size, 1, 20);
      const tip = new THREE.ConeGeometry(0.055 * thin * size, 0.16 * thin * size, 24);
      shaft.translate(0, 0.5, 0);
      const pair = [shaft, tip].map((geometry) => new THREE.Mesh(geometry, material));
      for (const part of pair) part.renderOrder = opacity < 1 ? 9 : 0;
      this.group.add(...pair);
      return { pair, material };
    });
    this.origin = new THREE.Vector3();
    this.vector = new THREE.Vector3();
  }

  // From an origin along a vector [m]; a color replaces its own.
  point(origin, vector, color) {
    this.origin.copy(origin);
    this.vector.set(...vector);
    for (const { material } of color ? this.parts : []) material.color.set(color);
  }

  // As much of it as the picture holds; returns which share that is.
  fit(camera) {
    const length = this.vector.length();
    this.group.visible = Number.isFinite(length) && length > 1e-9 * this.size;
    if (!this.group.visible) return 1;
    const share = rollkane.shareInPicture(camera, this.origin, this.vector);
    const direction = this.vector.clone().divideScalar(length);
    this.group.position.copy(this.origin);
    this.group.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), direction);
    for (const { pair } of this.parts) {
      pair[0].scale.y = share * length;
      pair[1].position.y = share * length;
    }
    this.end = this.origin.clone().addScaledVector(this.vector, share);
    return share;
  }
};

// The largest share of a vector whose end is in the picture, where its origin is.
rollkane.shareInPicture = (camera, origin, vector) => {
  const inside = (share) => {
    const { x, y, z } = origin.clone().addScaledVector(vector, share).project(camera);
    return Math.abs(x) < 0.94 && Math.abs(y) < 0.92 && Math.abs(z) < 1;
  };
  if (inside(1) || !inside(0)) return 1;
  let [low, high] = [0, 1];
  for (let k = 0; k < 20; k += 1) {
    const middle = 0.5 * (low + high);
    if (inside(middle)) low = middle;
    else high = middle;
  }
  return low;
};

rollkane.median = (values) => {
  const known = values.filter((x) => Number.isFinite(x)).sort((a, b) => a - b);
  return known.length ? known[known.length >> 1] : 0;
};

// Arrows of force, gravity, angular velocity and axes, each by a switch of its name.
rollkane.Arrows = class {
  constructor(data, motion) {
    const { colors, Arrow, median } = rollkane;
    const rows = [...Array(motion.count).keys()];
    const usual = (name) =>
      median(rows.map((k) => Math.hypot(...motion.row(name, k)))) || 1;
    const arms = rows.map((k) => Math.hypot(...motion.row("contact_on_body", k)));
    const { size, gravity } = data;
    // a usual force reaches beyond the body: twice its arm, and some more
    const reach = 2 * (arms.reduce((sum, x) => sum + x, 0) / motion.count) + 0.4 * size;
    this.size = size;
    this.gravity = gravity;
    this.scales = {
      force: reach / (data.force > 0 ? data.force : usual("contact_force")),
      gravity: gravity ? (1.3 * size) / Math.hypot(...gravity) : 1,
      omega: (1.5 * size) / usual("angular_velocity"),
    };
    this.units = { force: "N", gravity: "m/s\u00b2", omega: "rad/s" };
    const of = (color, thin) => [new Arrow(0.9 * size, color, thin)];
    const axes = colors.axes.map((color) => new Arrow(0.8 * size, color, 0.8));
    const fixed = colors.axes.map((color) => new Arrow(0.8 * size, color, 0.5));
    this.arrows = {
      force: of(colors.force),
      gravity: of(colors.gravity),
      omega: of(colors.spin),
      axes: [...axes, ...fixed],
    };
    this.names = { force: ["F"], gravity: ["g"], omega: ["\u03c9"],
      axes: ["x", "y", "z", "X", "Y", "Z"] };
    this.shown = { force: false, gravity: false, omega: false, axes: false };
    this.cut = {};
    this.values = {};
    this.group = new THREE.Group();
    for (const each of Object.values(this.arrows)) {
      this.group.add(...each.map((arrow) => arrow.group));
    }
  }

  show(state, contact, turn) {
    const { colors } = rollkane;
    const body = new THREE.Vector3(...state.position);
    this.corner = this.corner || contact.clone();
    const scaled = (name, vector) => vector.map((x) => this.scales[name] * x);
    const { force, gravity, omega, axes } = this.arrows;
    const tone = state.normalForce < 0 ? colors.pull : colors.force;
    force[0].point(contact, scaled("force", state.contact_force), tone);
    gravity[0].point(body, scaled("gravity", this.gravity || [0, 0, 0]));
    omega[0].point(body, scaled("omega", state.angular_velocity));
    [0, 1, 2].forEach((i) => {
      const unit = [0, 1, 2].map((j) => (i === j ? 1 : 0));
      const own = new THREE.Vector3(...unit).applyQuaternion(turn);
      axes[i].point(body, own.multiplyScalar(1.5 * this.size).toArray());
      axes[i + 3].point(this.corner, unit.map((x) => x * this.size));
    });
    this.values = {
      force: Math.hypot(...state.contact_force),
      gravity: this.gravity ? Math.hypot(...this.gravity) : 0,
      omega: Math.hypot(...state.angular_velocity),
    };
  }

  // Before a picture is drawn: no arrow leaves it.
  fit(camera) {
    for (const [name, each] of Object.entries(this.arrows)) {
      let least = 1;
      for (const arrow of each) {
        if (this.shown[name]) least = Math.min(least, arrow.fit(camera));
        else arrow.group.visible = false;
      }
      this.cut[name] = least < 1;
    }
  }

  // Names at the ends of arrows: text, and where in the picture, from -1 to 1.
  labels(camera) {
    const found = [];
    for (const [name, each] of Object.entries(this.arrows)) {
      each.forEach((arrow, k) => {
        if (!this.shown[name] || !arrow.group.visible) return;
        const { x, y } = arrow.end.clone().project(camera);
        found.push({ text: this.names[name][k], x, y });
      });
    }
    return found;
  }

  // What an arrow shows, and its scale, in words; empty where it is not shown.
  told(name) {
    if (!this.shown[name]) return "";
    const value = this.values[name];
    if (!Number.isFinite(value)) return "\u2013";
    const unit = this.units[name];
    const length = rollkane.roundLength(this.size);
    const [factor, small] = length < 0.1 ? [1000, "mm"] : [1, "m"];
    const stands = Number((length / this.scales[name]).toPrecision(2));
    const cut = this.cut[name] ? ", cut at the edge" : "";
    return `${Number(value.toPrecision(4))} ${unit} (arrow: ${Number((factor * length).toPrecision(2))} ${small} for ${stands} ${unit}${cut})`;
  }
};

// Other motions of the same body, as veils.
rollkane.Ghosts = class {
  constructor(data) {
    this.group = new THREE.Group();
    this.motions = data.ghosts.map((frames) => new rollkane.Motion(frames));
    if (!data.body || !this.motions.length) return;
    const geometry = rollkane.geometry(data.body);
    const material = new THREE.MeshStandardMaterial({
      color: rollkane.colors.ghost,
      roughness: 0.8,
      side: THREE.DoubleSide,
      transparent: true,
      opacity: Math.max(0.12, 0.4 / Math.sqrt(this.motions.length)),
      depthWrite: false,
    });
    for (const motion of this.motions) {
      const ghost = new THREE.Mesh(geometry, material);
      ghost.renderOrder = 4;
      ghost.visible = motion.count > 0;
      this.group.add(ghost);
    }
  }

  show({ elapsed }) {
    this.group.children.forEach((ghost, k) => {
      const motion = this.motions[k];
      const at = motion.locate(Math.min(elapsed, motion.duration));
      const [w, x, y, z] = motion.turned("orientation", "angular_velocity", at);
      ghost.position.set(...motion.place("position", "velocity", at));
      ghost.quaternion.set(x, y, z, w);
    });
  }
};
