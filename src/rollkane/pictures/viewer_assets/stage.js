// Everything that is seen: body, base, contact point, lights.
"use strict";

var rollkane = rollkane || {};

rollkane.colors = {
  body: ["#f4efe6", "#d9783c"],
  bodyMark: ["#cfe0f2", "#2f6aa8"],
  base: "#e9edf2",
  line: "#b4bfcc",
  baseTrace: "#1b4f91",
  bodyTrace: "#6a1f8a",
  contact: "#d11f2f",
  force: "#1d8a5f",
  gravity: "#8a5a00",
  spin: "#0b7a8c",
  ghost: "#7d8794",
  axes: ["#b3261e", "#2f7d32", "#1b4f91"],
  carried: "#5b2d8e",
  pull: "#b3261e",
};

rollkane.canvas = (width, height, draw) => {
  const canvas = document.createElement("canvas");
  canvas.width = width;
  canvas.height = height;
  draw(canvas.getContext("2d"), width, height);
  const texture = new THREE.CanvasTexture(canvas);
  texture.anisotropy = 8;
  return texture;
};

// Squares along the lines of the chart; one sector has another colour, so that a turn
// about an axis of symmetry is seen as well.
rollkane.checker = ([columns, rows]) => {
  const { body, bodyMark } = rollkane.colors;
  const texture = rollkane.canvas(1024, 512, (pen, width, height) => {
    for (let i = 0; i < columns; i += 1) {
      for (let j = 0; j < rows; j += 1) {
        pen.fillStyle = (i < 2 ? bodyMark : body)[(i + j) % 2];
        const [x, y] = [(i * width) / columns, (j * height) / rows];
        pen.fillRect(x, y, width / columns + 1, height / rows + 1);
      }
    }
  });
  texture.colorSpace = THREE.SRGBColorSpace;
  return texture;
};

// Lines on a curved base where two of its coordinates are multiples of a spacing [m]: of
// x, y and z the two that are most along the surface. Lines that would run into each
// other, where it is steep, fade.
rollkane.scale = (spacing, [first, second]) => (material) => {
  material.color.set(rollkane.colors.base);
  material.onBeforeCompile = (shader) => {
    shader.uniforms.spacing = { value: spacing };
    shader.uniforms.lineColor = { value: new THREE.Color(rollkane.colors.line) };
    shader.vertexShader = shader.vertexShader
      .replace("#include <common>", "#include <common>\nvarying vec3 vPlace;")
      .replace("#include <begin_vertex>", "#include <begin_vertex>\nvPlace = position;");
    shader.fragmentShader = shader.fragmentShader
      .replace("#include <common>", `#include <common>
        varying vec3 vPlace;
        uniform float spacing;
        uniform vec3 lineColor;`)
      .replace("#include <map_fragment>", `
        vec2 at = vec2(vPlace.${first}, vPlace.${second}) / spacing;
        vec2 pixel = max(fwidth(at), 1e-6);
        vec2 away = abs(fract(at - 0.5) - 0.5) / pixel;
        vec2 near = clamp(1.2 - away, 0.0, 1.0) * (1.0 - smoothstep(0.1, 0.4, pixel));
        diffuseColor.rgb = mix(diffuseColor.rgb, lineColor, max(near.x, near.y));`);
  };
};

// The two axes that are most along a surface whose normals are given.
rollkane.along = (motion) => {
  const sizes = [0, 0, 0];
  for (let k = 0; k < motion.count; k += 1) {
    motion.row(motion.baseNormals, k).forEach((x, i) => { sizes[i] += x * x; });
  }
  const across = sizes.indexOf(Math.max(...sizes));
  return ["x", "y", "z"].filter((_, i) => i !== across);
};

// Points of a mesh [m]; they come as shares of their box.
rollkane.points = (mesh) =>
  Float32Array.from(
    rollkane.unpack(mesh.points),
    (x, i) => mesh.low[i % 3] + x * (mesh.high[i % 3] - mesh.low[i % 3]),
  );

rollkane.geometry = (mesh) => {
  const geometry = new THREE.BufferGeometry();
  const put = (name, values, width) =>
    geometry.setAttribute(name, new THREE.BufferAttribute(values, width));
  put("position", rollkane.points(mesh), 3);
  put("normal", rollkane.unpack(mesh.normals), 3);
  put("uv", rollkane.unpack(mesh.marks), 2);
  geometry.setIndex(new THREE.BufferAttribute(rollkane.unpack(mesh.triangles), 1));
  return geometry;
};

// A surface that is opaque from the side of its normals and a veil from behind, so that
// one looks into hollows.
rollkane.cutaway = (geometry, finish) => {
  const group = new THREE.Group();
  const common = { roughness: 0.75, polygonOffset: true };
  const front = new THREE.MeshStandardMaterial({
    ...common,
    side: THREE.FrontSide,
    polygonOffsetFactor: 1,
    polygonOffsetUnits: 2,
  });
  const veil = new THREE.MeshStandardMaterial({
    ...common,
    side: THREE.BackSide,
    transparent: true,
    opacity: 0.16,
    depthWrite: false,
  });
  for (const material of [front, veil]) {
    finish(material);
    const part = new THREE.Mesh(geometry, material);
    part.receiveShadow = material === front;
    part.renderOrder = material === front ? 0 : 5;
    group.add(part);
  }
  return group;
};

// Length 1, 2 or 5 times a power of ten next below a length.
rollkane.roundLength = (length) => {
  const power = 10 ** Math.floor(Math.log10(length));
  return power * [5, 2, 1].find((x) => x * power <= length * 1.0001);
};

// A disc of the plane z = 0 with lines, faded towards its edge.
rollkane.ground = (center, radius, spacing) => {
  const { base, line } = rollkane.colors;
  const tiles = 2 * Math.ceil(radius / spacing);
  const grid = rollkane.canvas(256, 256, (pen, width, height) => {
    pen.fillStyle = base;
    pen.fillRect(0, 0, width, height);
    pen.fillStyle = line;
    pen.fillRect(0, 0, width, 3);
    pen.fillRect(0, 0, 3, height);
  });
  grid.colorSpace = THREE.SRGBColorSpace;
  grid.wrapS = grid.wrapT = THREE.RepeatWrapping;
  grid.repeat.set(tiles, tiles);
  const fade = rollkane.canvas(256, 256, (pen, width, height) => {
    const light = pen.createRadialGradient(128, 128, 0, 128, 128, 128);
    light.addColorStop(0, "#fff");
    light.addColorStop(0.55, "#fff");
    light.addColorStop(1, "#000");
    pen.fillStyle = light;
    pen.fillRect(0, 0, width, height);
  });
  const material = new THREE.MeshStandardMaterial({
    map: grid,
    alphaMap: fade,
    transparent: true,
    roughness: 0.9,
    side: THREE.DoubleSide,
    polygonOffset: true,
    polygonOffsetFactor: 1,
    polygonOffsetUnits: 2,
  });
  const width = tiles * spacing;
  const ground = new THREE.Mesh(new THREE.PlaneGeometry(width, width), material);
  // lines stay on whole multiples of the spacing
  ground.position.set(...center.slice(0, 2).map((x) => spacing * Math.round(x / spacing)), 0);
  ground.receiveShadow = true;
  ground.renderOrder = -1;
  return ground;
};

// Which part of a plane base is drawn: all of the picture, or, where the base moves, the
// contact's path on it and a good part around.
rollkane.reached = (motion, box) => {
  if (!motion.baseMoves) return { center: box.center, radius: 3.2 * box.radius };
  const low = [Infinity, Infinity];
  const high = [-Infinity, -Infinity];
  for (let k = 0; k < motion.count; k += 1) {
    const point = motion.row("contact_on_base", k);
    for (const i of [0, 1]) {
      low[i] = Math.min(low[i], point[i]);
      high[i] = Math.max(high[i], point[i]);
    }
  }
  const half = low.map((x, i) => 0.5 * (high[i] - x));
  return {
    center: low.map((x, i) => x + half[i]),
    radius: 1.5 * Math.hypot(...half) + 0.8 * box.radius,
  };
};

rollkane.Stage = class {
  constructor(data, motion, box) {
    const { colors } = rollkane;
    this.size = data.size;
    this.motion = motion;
    this.scene = new THREE.Scene();
    this.lights(box.eye);
    this.body = new THREE.Group();
    const inside = data.rolling.some(({ carrier, on }) => carrier < 0 && on);
    const seenThrough = data.carried.length > 0 || inside;
    if (data.body) this.body.add(this.shell(data.body, seenThrough));
    this.carried = this.masses(data.carried);
    for (const ball of this.carried) this.body.add(ball);
    this.rolling = this.rollingBodies(data);
    this.base = new THREE.Group();
    this.spacing = 0;
    if (data.base && data.base.plane) {
      this.spacing = rollkane.roundLength(0.15 * box.radius);
      this.lay(rollkane.reached(motion, box));
      this.reach(motion);
    } else if (data.base) {
      this.spacing = rollkane.roundLength(0.3 * box.radius);
      const geometry = rollkane.geometry(data.base);
      const lines = rollkane.scale(this.spacing, rollkane.along(motion));
      this.base.add(rollkane.cutaway(geometry, lines));
    }
    this.onBase = new rollkane.Trace(
      this.path("contact_on_base", motion.baseNormals), colors.baseTrace);
    this.onBody = new rollkane.Trace(
      this.path("contact_on_body", "body_outward"), colors.bodyTrace);
    this.body.add(this.onBody.group);
    this.contact = this.marker();
    this.arrows = new rollkane.Arrows(data, motion);
    this.ghosts = new rollkane.Ghosts(data);
    this.base.add(this.onBase.group, this.contact);
    this.scene.add(this.body, this.base, ...this.rolling);
    this.scene.add(this.arrows.group, this.ghosts.group);
  }

  // Another motion of the same bodies.
  replaceMotion(motion, data) {
    const { colors } = rollkane;
    this.motion = motion;
    this.base.remove(this.onBase.group);
    this.body.remove(this.onBody.group);
    const visible = this.onBase.group.visible;
    for (const trace of [this.onBase, this.onBody]) trace.dispose();
    this.onBase = new rollkane.Trace(
      this.path("contact_on_base", motion.baseNormals), colors.baseTrace);
    this.onBody = new rollkane.Trace(
      this.path("contact_on_body", "body_outward"), colors.bodyTrace);
    this.onBase.group.visible = this.onBody.group.visible = visible;
    this.base.add(this.onBase.group);
    this.body.add(this.onBody.group);
    this.arrows.gravity = data.gravity;
    if (this.laid) this.reach(motion);
  }

  // A plane base, around a place on it.
  lay({ center, radius }) {
    this.laid = { center, radius };
    this.ground = rollkane.ground(center, radius, this.spacing);
    this.base.add(this.ground);
  }

  // More of a plane base, where a motion comes to its faded edge.
  reach(motion) {
    const { center, radius } = this.laid;
    let farthest = 0;
    for (let k = 0; k < motion.count; k += 1) {
      const [x, y] = motion.row("contact_on_base", k);
      farthest = Math.max(farthest, Math.hypot(x - center[0], y - center[1]) || 0);
    }
    if (1.5 * farthest <= radius) return;
    const { geometry, material } = this.ground;
    this.base.remove(this.ground);
    for (const part of [geometry, material.map, material.alphaMap, material]) part.dispose();
    this.lay({ center, radius: 2 * farthest });
  }

  lights(eye) {
    this.scene.add(new THREE.HemisphereLight("#ffffff", "#cdd4de", 1.9));
    this.sun = new THREE.DirectionalLight("#ffffff", 1.7);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(2048, 2048);
    const { camera } = this.sun.shadow;
    const reach = 3 * this.size;
    Object.assign(camera, { left: -reach, right: reach, top: reach, bottom: -reach });
    Object.assign(camera, { near: 0.1 * this.size, far: 20 * this.size });
    this.sun.shadow.normalBias = 0.01 * this.size;
    this.sun.shadow.bias = -0.0005;
    this.scene.add(this.sun, this.sun.target);
    // from above, over the left shoulder of who looks
    const [x, y] = eye;
    this.sunward = new THREE.Vector3(0.5 * x + 0.8 * y, 0.5 * y - 0.8 * x, 1.5).setLength(9);
  }

  // The body; one that carries something is seen through.
  shell(mesh, seenThrough) {
    const geometry = rollkane.geometry(mesh);
    const texture = rollkane.checker(mesh.cells);
    const shell = mesh.hollow
      ? rollkane.cutaway(geometry, (material) => { material.map = texture; })
      : new THREE.Mesh(
          geometry,
          new THREE.MeshStandardMaterial({
            map: texture,
            roughness: 0.5,
            side: THREE.DoubleSide,
            transparent: seenThrough,
            opacity: seenThrough ? 0.45 : 1,
            depthWrite: !seenThrough,
          }),
        );
    shell.traverse((part) => { part.castShadow = true; });
    return shell;
  }

  // Bodies that roll on or in the body, and the surfaces on which they do.
  rollingBodies(data) {
    const groups = data.rolling.map(() => new THREE.Group());
    data.rolling.forEach(({ body, on, carrier, place, turn }, k) => {
      const carries = data.rolling.some((other) => other.carrier === k);
      if (body) groups[k].add(this.shell(body, carries || data.carried.length > 0));
      if (on) {
        const surface = this.shell(on, true);
        surface.position.set(...place);
        const [w, x, y, z] = turn;
        surface.quaternion.set(x, y, z, w);
        (carrier < 0 ? this.body : groups[carrier]).add(surface);
      }
    });
    return groups;
  }

  // A ball for each carried mass, of its volume's share.
  masses(weights) {
    const most = Math.max(...weights, 1e-300);
    return weights.map((weight) => {
      const radius = 0.1 * this.size * Math.cbrt(weight / most);
      const ball = new THREE.Mesh(
        new THREE.SphereGeometry(radius, 24, 16),
        new THREE.MeshStandardMaterial({ color: rollkane.colors.carried, roughness: 0.4 }),
      );
      ball.castShadow = true;
      return ball;
    });
  }

  marker() {
    const group = new THREE.Group();
    for (const opacity of [0.55, 1]) {
      const ball = new THREE.Mesh(
        new THREE.SphereGeometry(0.04 * this.size, 24, 16),
        new THREE.MeshBasicMaterial({
          color: rollkane.colors.contact,
          opacity,
          transparent: opacity < 1,
          depthTest: opacity === 1,
        }),
      );
      ball.renderOrder = opacity < 1 ? 10 : 0;
      group.add(ball);
    }
    return group;
  }

  // a point of a path, a little outside the surface
  lifted(point, normal) {
    return point.map((x, i) => x + 0.004 * this.size * normal[i]);
  }

  path(points, normals) {
    const rows = [...Array(this.motion.count).keys()];
    return rows.map((k) => this.lifted(this.motion.row(points, k), this.motion.row(normals, k)));
  }

  show(state) {
    const [w, x, y, z] = state.orientation;
    this.body.position.set(...state.position);
    this.body.quaternion.set(x, y, z, w);
    const [bw, bx, by, bz] = state.base.orientation;
    this.base.position.set(...state.base.origin);
    this.base.quaternion.set(bx, by, bz, bw);
    this.rolling.forEach((group, k) => {
      const [rw, rx, ry, rz] = state.rolling[k].orientation;
      group.position.set(...state.rolling[k].position);
      group.quaternion.set(rx, ry, rz, rw);
    });
    this.carried.forEach((ball, k) =>
      ball.position.set(...state.carried.slice(3 * k, 3 * k + 3)));
    this.contact.position.set(...state.contact_on_base);
    this.onBase.show(state.frame, this.lifted(state.contact_on_base, state.base_outward));
    this.onBody.show(state.frame, this.lifted(state.contact_on_body, state.body_outward));
    const contact = new THREE.Vector3(...state.contact_on_base);
    contact.applyQuaternion(this.base.quaternion).add(this.base.position);
    this.arrows.show(state, contact, this.body.quaternion);
    this.ghosts.show(state);
    this.sun.target.position.copy(this.body.position);
    this.sun.position.copy(this.sunward).multiplyScalar(this.size).add(this.body.position);
  }
};
