// The frames of a motion, and the state between two of them.
// Vectors are plain arrays; quaternions are scalar first, body to fixed axes.
"use strict";

var rollkane = rollkane || {};

rollkane.FLYING = 2; // of rollkane.Mode: there is no normal to spin about

rollkane.unpack = (packed) => {
  const types = {
    float64: Float64Array,
    float32: Float32Array,
    int16: Int16Array,
    uint16: Uint16Array,
    int8: Int8Array,
  };
  const text = atob(packed.data);
  const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  const values = new types[packed.type](bytes.buffer);
  return packed.unit === 1 ? values : Float32Array.from(values, (x) => packed.unit * x);
};

rollkane.quaternions = {
  product: ([a, b, c, d], [e, f, g, h]) => [
    a * e - b * f - c * g - d * h,
    a * f + b * e + c * h - d * g,
    a * g - b * h + c * e + d * f,
    a * h + b * g - c * f + d * e,
  ],
  inverse: ([a, b, c, d]) => [a, -b, -c, -d],
  // rotation by the length of a vector about its direction
  turn: (v) => {
    const angle = Math.hypot(...v);
    const share = angle > 1e-12 ? Math.sin(angle / 2) / angle : 0.5;
    return [Math.cos(angle / 2), ...v.map((x) => x * share)];
  },
  // a vector on turned axes, on the axes from which they were turned
  rotate: (q, v) => {
    const { product, inverse } = rollkane.quaternions;
    return product(product(q, [0, ...v]), inverse(q)).slice(1);
  },
  // the inverse of turn, by the shorter way
  vector: ([a, b, c, d]) => {
    const sign = a < 0 ? -1 : 1;
    const sine = Math.hypot(b, c, d);
    const share = sine > 1e-12 ? (2 * Math.atan2(sine, sign * a)) / sine : 2;
    return [b, c, d].map((x) => sign * x * share);
  },
};

rollkane.Motion = class {
  constructor(frames) {
    this.columns = {};
    for (const [name, packed] of Object.entries(frames)) {
      this.columns[name] = rollkane.unpack(packed);
    }
    this.time = this.columns.time;
    this.count = this.time.length;
    this.duration = Math.abs(this.time[this.count - 1] - this.time[0]);
  }

  row(name, k) {
    const column = this.columns[name];
    const width = column.length / this.count;
    return Array.from(column.subarray(width * k, width * (k + 1)));
  }

  elapsed(k) {
    return Math.abs(this.time[k] - this.time[0]);
  }

  // Frame at or before a time, counted from the first frame, and the share of the way
  // to the next.
  locate(elapsed) {
    let low = 0;
    let high = this.count - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (this.elapsed(middle) <= elapsed) low = middle;
      else high = middle;
    }
    const step = this.elapsed(high) - this.elapsed(low);
    const share = step > 0 ? (elapsed - this.elapsed(low)) / step : 0;
    return { low, high, share: Math.min(Math.max(share, 0), 1) };
  }

  between(name, { low, high, share }) {
    const end = this.row(name, high);
    return this.row(name, low).map((x, i) => x + share * (end[i] - x));
  }

  // Cubic through the positions with the velocities of both frames.
  place(position, velocity, { low, high, share: s }) {
    const [p, q] = [this.row(position, low), this.row(position, high)];
    const [v, w] = [this.row(velocity, low), this.row(velocity, high)];
    const step = this.time[high] - this.time[low];
    return p.map(
      (x, i) =>
        x +
        s * s * (3 - 2 * s) * (q[i] - x) +
        s * (1 - s) * step * ((1 - s) * v[i] - s * w[i]),
    );
  }

  // Turn with the mean angular velocity, so that what turns more than once between two
  // frames does so here, too; what is left over is spread evenly.
  turned(orientation, velocity, { low, high, share }) {
    const { product, inverse, turn, vector } = rollkane.quaternions;
    const [start, end] = [this.row(orientation, low), this.row(orientation, high)];
    const step = this.time[high] - this.time[low];
    const spin = this.row(velocity, high);
    const mean = this.row(velocity, low).map((x, i) => 0.5 * step * (x + spin[i]));
    const rest = vector(product(end, inverse(product(turn(mean), start))));
    const part = (v) => turn(v.map((x) => share * x));
    return product(part(rest), product(part(mean), start));
  }

  get baseMoves() {
    return "base_origin" in this.columns;
  }

  // Which column has the normals on base axes.
  get baseNormals() {
    return this.baseMoves ? "base_outward" : "outward";
  }

  // The columns about the base; of one at rest they are not sent.
  base(at) {
    if (!this.baseMoves) return { origin: [0, 0, 0], orientation: [1, 0, 0, 0] };
    return {
      origin: this.place("base_origin", "base_velocity", at),
      orientation: this.turned("base_orientation", "base_angular_velocity", at),
    };
  }

  state(elapsed) {
    const at = this.locate(elapsed);
    const state = {
      frame: at.low,
      elapsed,
      position: this.place("position", "velocity", at),
      orientation: this.turned("orientation", "angular_velocity", at),
      base: this.base(at),
    };
    for (const name of ["time", "energy"]) state[name] = this.between(name, at)[0];
    for (const name of [
      "angular_velocity",
      "contact_on_base",
      "contact_on_body",
      "outward",
      "body_outward",
      "contact_force",
    ]) {
      state[name] = this.between(name, at);
    }
    state.mode = "mode" in this.columns ? this.columns.mode[at.low] : -1;
    state.rolling = [];
    while (`rolling_${state.rolling.length}_position` in this.columns) {
      const name = `rolling_${state.rolling.length}`;
      state.rolling.push({
        position: this.place(`${name}_position`, `${name}_velocity`, at),
        orientation: this.turned(`${name}_orientation`, `${name}_angular_velocity`, at),
      });
    }
    state.base_outward = this.between(this.baseNormals, at);
    state.carried = "carried" in this.columns ? this.between("carried", at) : [];
    const along = (v) => v.reduce((sum, x, i) => sum + x * state.outward[i], 0);
    state.spin = state.mode === rollkane.FLYING ? NaN : along(state.angular_velocity);
    state.normalForce = along(state.contact_force);
    return state;
  }
};
