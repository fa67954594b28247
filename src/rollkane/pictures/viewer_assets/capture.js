// Pictures and videos of what is seen, as files.
"use strict";

var rollkane = rollkane || {};

// Gives a file to who looks at the page.
rollkane.save = (blob, name) => {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
};

// The picture with its names, clock and heading, on a canvas.
rollkane.composed = (player, canvas) => {
  const source = player.renderer.domElement;
  canvas.width = source.width;
  canvas.height = source.height;
  const pen = canvas.getContext("2d");
  const ratio = source.width / Math.max(source.clientWidth, 1);
  const light = pen.createLinearGradient(0, 0, 0, canvas.height);
  light.addColorStop(0, "#f7f9fb");
  light.addColorStop(1, "#dfe5ec");
  pen.fillStyle = light;
  pen.fillRect(0, 0, canvas.width, canvas.height);
  player.draw();
  pen.drawImage(source, 0, 0);
  pen.fillStyle = "#2b3340";
  pen.font = `${13 * ratio}px system-ui, sans-serif`;
  for (const { text, x, y } of player.stage.arrows.labels(player.camera)) {
    pen.fillText(text, (0.5 + 0.5 * x) * canvas.width + 4 * ratio,
      (0.5 - 0.5 * y) * canvas.height);
  }
  const clock = `${rollkane.element("time").textContent} s`;
  pen.fillText(`${player.title}   ${clock}`, 14 * ratio, canvas.height - 14 * ratio);
  return canvas;
};

rollkane.fileName = (player, ending) => {
  const name = player.title.toLowerCase().replace(/[^a-z0-9]+/g, "-").slice(0, 60);
  return `${name.replace(/^-|-$/g, "") || "motion"}.${ending}`;
};

rollkane.screenshot = (player) => {
  const canvas = rollkane.composed(player, document.createElement("canvas"));
  canvas.toBlob((blob) => rollkane.save(blob, rollkane.fileName(player, "png")));
};

// The motion from its beginning to its end, as it is seen from here.
rollkane.Recorder = class {
  constructor(player, button) {
    this.player = player;
    this.button = button;
    this.recorder = null;
    button.hidden = !("MediaRecorder" in window);
  }

  toggle() {
    if (this.recorder) this.finish();
    else this.start();
  }

  start() {
    const { player } = this;
    this.canvas = document.createElement("canvas");
    rollkane.composed(player, this.canvas);
    const kinds = ["video/webm;codecs=vp9", "video/webm", "video/mp4"];
    const mimeType = kinds.find((kind) => MediaRecorder.isTypeSupported(kind));
    const pieces = [];
    this.recorder = new MediaRecorder(this.canvas.captureStream(30), {
      mimeType,
      videoBitsPerSecond: 8e6,
    });
    const ending = mimeType.includes("mp4") ? "mp4" : "webm";
    this.recorder.ondataavailable = ({ data }) => pieces.push(data);
    this.recorder.onstop = () => {
      const type = mimeType.split(";")[0];
      rollkane.save(new Blob(pieces, { type }), rollkane.fileName(player, ending));
    };
    this.button.classList.add("on");
    this.recorder.start();
    player.jump(0);
    player.play(true);
  }

  // After each picture.
  frame() {
    if (!this.recorder) return;
    rollkane.composed(this.player, this.canvas);
    if (!this.player.playing) this.finish();
  }

  finish() {
    const { recorder } = this;
    this.recorder = null;
    this.button.classList.remove("on");
    setTimeout(() => recorder.stop(), 100); // the last picture, too
  }
};
