// Sliders of a scene's numbers; each change asks the server for the motion anew.
"use strict";

rollkane.Live = class {
  constructor(player) {
    this.player = player;
    this.numbers = player.data.numbers;
    this.values = Object.fromEntries(this.numbers.map(({ path, value }) => [path, value]));
    this.shown = { ...this.values }; // of the motion that is on the page
    this.busy = false;
    this.asked = false;
    this.frames = []; // when the last motions came [ms]
    this.build();
  }

  build() {
    const panel = document.createElement("details");
    panel.id = "live";
    panel.open = window.innerWidth > 720;
    const head = document.createElement("summary");
    head.textContent = "numbers of the scene";
    const again = document.createElement("button");
    again.type = "button";
    again.id = "restore";
    again.textContent = "as in the file";
    again.addEventListener("click", () => this.restore());
    this.told = document.createElement("p");
    this.told.id = "live-told";
    this.inputs = {};
    panel.append(head, ...this.numbers.map((number) => this.row(number)), again, this.told);
    document.body.append(panel);
    document.body.classList.add("live");
  }

  row({ path, value, low, high }) {
    const row = document.createElement("label");
    const name = document.createElement("span");
    const input = document.createElement("input");
    const shown = document.createElement("output");
    name.textContent = path;
    Object.assign(input, { type: "range", min: low, max: high, step: "any", value });
    input.dataset.path = path;
    shown.textContent = String(Number(value.toPrecision(4)));
    input.addEventListener("input", () => {
      this.values[path] = Number(input.value);
      shown.textContent = String(Number(this.values[path].toPrecision(4)));
      this.ask();
    });
    this.inputs[path] = { input, shown };
    row.append(name, input, shown);
    return row;
  }

  restore() {
    for (const { path, value } of this.numbers) {
      this.values[path] = value;
      this.inputs[path].input.value = value;
      this.inputs[path].shown.textContent = String(Number(value.toPrecision(4)));
    }
    this.ask();
  }

  // One question at a time; what is dragged in between is asked for in the next one.
  async ask() {
    this.asked = true;
    if (this.busy) return;
    this.busy = true;
    while (this.asked) {
      this.asked = false;
      await this.once();
    }
    this.busy = false;
  }

  async once() {
    const values = { ...this.values };
    try {
      const answer = await fetch("run", {
        method: "POST",
        headers: { "Content-Type": "application/json" },
        body: JSON.stringify({ values, shown: this.shown, drawn: this.drawn() }),
      });
      const data = await answer.json();
      if (data.refused) this.tell(data.refused, true);
      else this.take(data, values);
    } catch {
      this.tell("the program behind this page has ended", true);
    }
  }

  // Boxes of the meshes that are on the page; null for those that have no edge.
  drawn() {
    const { base, body, rolling } = this.player.data;
    const meshes = [base, body, ...rolling.flatMap((own) => [own.body, own.on])];
    return meshes.map((mesh) => (mesh && mesh.low ? [mesh.low, mesh.high] : null));
  }

  take(data, values) {
    this.shown = values;
    this.player.replace(data);
    const now = performance.now();
    this.frames = [...this.frames.filter((then) => now - then < 1000), now];
    this.tell(`${this.frames.length} runs in the last second`, false);
  }

  tell(text, bad) {
    this.told.textContent = text;
    this.told.className = bad ? "refused" : "";
  }
};

if (rollkane.player) rollkane.live = new rollkane.Live(rollkane.player);
