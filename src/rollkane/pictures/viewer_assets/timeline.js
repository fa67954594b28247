// The time line: modes, events and the graph of a quantity, linked to the slider.
"use strict";

var rollkane = rollkane || {};

// Name, unit and components of what can be drawn over time.
rollkane.QUANTITIES = {
  spin: ["spin about the normal", "rad/s", ""],
  normal_force: ["normal force", "N", ""],
  energy: ["energy", "J", ""],
  position: ["position of the body origin", "m", "xyz"],
  velocity: ["velocity of the body origin", "m/s", "xyz"],
  angular_velocity: ["angular velocity", "rad/s", "xyz"],
  orientation: ["orientation, body to fixed", "", "wxyz"],
  contact_force: ["contact force", "N", "xyz"],
  contact_on_base: ["contact point, base axes", "m", "xyz"],
  contact_on_body: ["contact point, body axes", "m", "xyz"],
  alpha: ["coordinates inside", "", ""],
  base_origin: ["origin of the base", "m", "xyz"],
  base_velocity: ["velocity of the base", "m/s", "xyz"],
  base_angular_velocity: ["angular velocity of the base", "rad/s", "xyz"],
};

rollkane.INKS = ["#1b4f91", "#c4541a", "#2f7d32", "#6a1f8a"];
rollkane.DASHES = [[], [6, 3], [2, 2], [8, 3, 2, 3]]; // told apart in grey, too
rollkane.MODES = [["rolls", "#dfe9f5"], ["slips", "#f6e2cc"], ["flies", "#e9def3"]];

rollkane.happenings = ({ events }) =>
  events.flatMap(({ name, times }) => times.map((time) => ({ name, time })));

rollkane.Timeline = class {
  constructor(player, data, canvas, select) {
    this.player = player;
    this.motion = player.motion;
    this.canvas = canvas;
    this.select = select;
    this.happenings = rollkane.happenings(data);
    this.tall = true;
    for (const [key, [name, unit]] of this.known(data)) {
      select.add(new Option(unit ? `${name} [${unit}]` : name, key));
    }
    this.energy = data.energy_label;
    this.listen();
  }

  // Another motion, with the same quantities.
  replace(motion, data) {
    this.motion = motion;
    this.happenings = rollkane.happenings(data);
    this.prepare();
  }

  known(data) {
    const names = { ...rollkane.QUANTITIES };
    const [name, unit] = data.energy_label;
    names.energy = [name, unit, ""];
    return Object.entries(names).filter(
      ([key]) => key === "spin" || key === "normal_force" || key in this.motion.columns);
  }

  get matters() {
    return this.tall || "mode" in this.motion.columns || this.happenings.length > 0;
  }

  // Curves of the chosen quantity: names and numbers.
  curves() {
    const { motion } = this;
    const key = this.select.value;
    const rows = [...Array(motion.count).keys()];
    const along = (name) => (k) => {
      const normal = motion.row("outward", k);
      return motion.row(name, k).reduce((sum, x, i) => sum + x * normal[i], 0);
    };
    const touches = (k) => motion.columns.mode?.[k] !== rollkane.FLYING;
    const spin = (k) => (touches(k) ? along("angular_velocity")(k) : NaN);
    if (key === "spin") return [{ name: "", values: rows.map(spin) }];
    if (key === "normal_force") return [{ name: "", values: rows.map(along("contact_force")) }];
    const width = motion.columns[key].length / motion.count;
    const names = rollkane.QUANTITIES[key][2];
    return [...Array(width).keys()].map((i) => ({
      name: names[i] || (width > 1 ? String(i) : ""),
      values: rows.map((k) => motion.columns[key][k * width + i]),
    }));
  }

  get area() {
    const { clientWidth, clientHeight } = this.canvas;
    return this.tall
      ? { left: 62, top: 16, right: clientWidth - 10, bottom: clientHeight - 16 }
      : { left: 10, top: 2, right: clientWidth - 10, bottom: clientHeight - 2 };
  }

  x(elapsed) {
    const { left, right } = this.area;
    return left + ((right - left) * elapsed) / (this.motion.duration || 1);
  }

  elapsedAt(x) {
    const { left, right } = this.area;
    return (this.motion.duration * (x - left)) / Math.max(right - left, 1);
  }

  // Everything that does not move with the clock.
  prepare() {
    this.canvas.hidden = !this.matters;
    this.canvas.className = this.tall ? "tall" : "";
    this.select.hidden = !this.tall;
    const { clientWidth, clientHeight } = this.canvas;
    const ratio = Math.min(window.devicePixelRatio, 2);
    this.canvas.width = Math.max(1, Math.round(ratio * clientWidth));
    this.canvas.height = Math.max(1, Math.round(ratio * clientHeight));
    this.picture = document.createElement("canvas");
    this.picture.width = this.canvas.width;
    this.picture.height = this.canvas.height;
    const pen = this.picture.getContext("2d");
    pen.scale(ratio, ratio);
    pen.font = "11px system-ui, sans-serif";
    this.ratio = ratio;
    this.drawModes(pen);
    if (this.tall) this.drawCurves(pen);
    this.drawEvents(pen);
    this.show();
  }

  drawModes(pen) {
    const modes = this.motion.columns.mode;
    const { top, bottom, left, right } = this.area;
    pen.fillStyle = "#f4f6f9";
    pen.fillRect(left, top, right - left, bottom - top);
    if (!modes) return;
    let first = 0;
    for (let k = 1; k <= modes.length; k += 1) {
      if (k < modes.length && modes[k] === modes[first]) continue;
      const known = rollkane.MODES[modes[first]];
      const from = this.x(this.motion.elapsed(first));
      const to = this.x(this.motion.elapsed(Math.min(k, modes.length - 1)));
      if (known) {
        pen.fillStyle = known[1];
        pen.fillRect(from, top, to - from, bottom - top);
        pen.fillStyle = "#4d5866";
        const wide = pen.measureText(known[0]).width + 6 < to - from;
        if (wide) pen.fillText(known[0], from + 3, bottom - 3);
      }
      first = k;
    }
  }

  drawEvents(pen) {
    const { top, bottom } = this.area;
    const zero = this.motion.time[0];
    let free = -Infinity; // where the last name ended
    pen.strokeStyle = pen.fillStyle = "#b3261e";
    for (const { name, time } of this.happenings) {
      const x = this.x(Math.abs(time - zero));
      pen.beginPath();
      pen.moveTo(x, top);
      pen.lineTo(x, bottom);
      pen.stroke();
      if (this.tall && x > free) {
        pen.fillText(name, x + 2, top - 5);
        free = x + pen.measureText(name).width + 8;
      }
    }
  }

  drawCurves(pen) {
    const { left, right, top, bottom } = this.area;
    const curves = this.curves();
    let [low, high] = [Infinity, -Infinity];
    for (const { values } of curves) {
      for (const v of values) {
        if (Number.isFinite(v)) [low, high] = [Math.min(low, v), Math.max(high, v)];
      }
    }
    if (!(low <= high)) return;
    const least = 1e-6 * Math.max(Math.abs(low), Math.abs(high)) || 1e-9;
    if (high - low < least) [low, high] = [low - least, high + least];
    const y = (v) => bottom - 3 - ((bottom - top - 6) * (v - low)) / (high - low);
    pen.fillStyle = "#66707e";
    pen.textAlign = "right";
    const digits = (v) => String(Number(v.toPrecision(4)));
    pen.fillText(digits(high), left - 5, top + 9);
    pen.fillText(digits(low), left - 5, bottom - 1);
    pen.textAlign = "left";
    pen.fillText(`${digits(this.motion.time[0])} s`, left, bottom + 13);
    pen.textAlign = "right";
    pen.fillText(`${digits(this.motion.time[this.motion.count - 1])} s`, right, bottom + 13);
    pen.textAlign = "left";
    if (low < 0 && high > 0) {
      pen.fillStyle = "#b4bfcc";
      pen.fillRect(left, y(0), right - left, 1);
    }
    curves.forEach(({ name, values }, k) => {
      pen.strokeStyle = pen.fillStyle = rollkane.INKS[k % 4];
      pen.setLineDash(rollkane.DASHES[k % 4]);
      pen.lineWidth = 1.3;
      pen.beginPath();
      values.forEach((v, i) => {
        if (!Number.isFinite(v)) return;
        const gap = i === 0 || !Number.isFinite(values[i - 1]);
        pen[gap ? "moveTo" : "lineTo"](this.x(this.motion.elapsed(i)), y(v));
      });
      pen.stroke();
      pen.setLineDash([]);
      if (name) pen.fillText(name, left + 6 + 16 * k, bottom + 13);
    });
  }

  show() {
    if (!this.picture || this.canvas.hidden) return;
    const pen = this.canvas.getContext("2d");
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    pen.drawImage(this.picture, 0, 0);
    const { top, bottom } = this.area;
    pen.fillStyle = "#d11f2f";
    const x = this.x(this.player.elapsed);
    pen.fillRect((x - 0.75) * this.ratio, top * this.ratio, 1.5 * this.ratio,
      (bottom - top) * this.ratio);
  }

  listen() {
    const seek = (event) => {
      const box = this.canvas.getBoundingClientRect();
      this.player.jump(this.elapsedAt(event.clientX - box.left));
    };
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      seek(event);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) seek(event);
    });
    this.select.addEventListener("change", () => this.prepare());
  }
};
