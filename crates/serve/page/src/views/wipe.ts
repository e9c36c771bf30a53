// Two results of one frame on top of each other, with a movable boundary.

import { h, iconButton, sized } from "../dom.ts";
import { paint, table } from "../model/colours.ts";
import { metres, quantiles } from "../model/numbers.ts";
import * as npy from "../model/npy.ts";
import { ServiceError, type Frame, type Service } from "../service.ts";
import type { Pair } from "./gallery.ts";

type Side = { values: npy.Map2 } | { picture: ImageBitmap };

export class Wipe {
  readonly element: HTMLDialogElement;
  private readonly canvas = h("canvas", { role: "img" });
  private readonly title = h("h2", {});
  private readonly labels = [h("span", { class: "left" }), h("span", { class: "right" })] as const;
  private readonly scale = h("p", { class: "why" });
  private readonly share = h("input", { type: "range", min: "0", max: "1000", value: "500", "aria-label": "Boundary between the two", oninput: () => this.draw() });
  private readonly reopen = h("button", { type: "button" }, "Open in the viewer");
  private readonly area: HTMLDivElement;
  private sides: [Side | null, Side | null] = [null, null];
  private painted: (CanvasImageSource | null)[] = [];
  private pairs: readonly Pair[] = [];
  private names: readonly [string, string | null] = ["", null];
  private at = 0;

  constructor(private readonly service: Service, private readonly view: (frame: Frame) => void) {
    this.area = h("div", { class: "wipe-area" }, this.canvas, ...this.labels);
    this.element = h("dialog", { class: "wipe", "aria-label": "Comparison" },
      h("header", {}, iconButton("previous", "Previous frame", () => this.go(-1)), iconButton("next", "Next frame", () => this.go(1)),
        this.title, this.reopen, iconButton("close", "Close", () => this.element.close())),
      this.area, this.share, this.scale);
    const follow = (event: PointerEvent) => {
      const box = this.canvas.getBoundingClientRect();
      this.share.value = String(Math.round((1000 * (event.clientX - box.left)) / box.width));
      this.draw();
    };
    this.area.addEventListener("pointerdown", (event) => {
      this.area.setPointerCapture(event.pointerId);
      follow(event);
    });
    this.area.addEventListener("pointermove", (event) => event.buttons && follow(event));
    this.element.addEventListener("keydown", (event) => {
      if (event.target === this.share) return;
      if (event.key === "ArrowLeft") this.go(-1);
      else if (event.key === "ArrowRight") this.go(1);
    });
    this.reopen.addEventListener("click", () => {
      const pair = this.pairs[this.at];
      const frame = pair?.a ?? pair?.b;
      this.element.close();
      if (frame) this.view(frame);
    });
    new ResizeObserver(() => this.draw()).observe(this.area);
  }

  open(pairs: readonly Pair[], at: number, names: readonly [string, string | null]): void {
    [this.pairs, this.at, this.names] = [pairs, at, names];
    this.element.showModal();
    void this.load();
  }

  private go(by: number): void {
    this.at = (this.at + by + this.pairs.length) % this.pairs.length;
    void this.load();
  }

  private async load(): Promise<void> {
    const pair = this.pairs[this.at];
    if (!pair) return;
    this.title.textContent = pair.id;
    this.reopen.hidden = !(pair.a ?? pair.b)?.image;
    this.painted = [];
    this.scale.textContent = "";
    const failure = pair.a?.failure ?? pair.b?.failure;
    // A single run is compared with the image.
    const places = this.names[1] === null ? [pair.a?.image, pair.a?.depth] : [pair.a?.depth, pair.b?.depth];
    const word = (name: string, frame: Frame | null) => (frame?.error == null ? name : `${name}: ${metres(frame.error)}`);
    const words = this.names[1] === null ? ["image", word(this.names[0], pair.a)] : [word(this.names[0], pair.a), word(this.names[1], pair.b)];
    this.labels.forEach((label, i) => (label.textContent = words[i]!));
    try {
      const sides = await Promise.all(places.map((address) => (address ? side(this.service, address) : null)));
      if (this.pairs[this.at] !== pair) return;
      this.sides = [sides[0] ?? null, sides[1] ?? null];
      this.paint();
      if (failure) this.scale.textContent = failure;
    } catch (error) {
      this.sides = [null, null];
      const hint = error instanceof ServiceError ? error.hint : null;
      this.scale.textContent = `${error instanceof Error ? error.message : error}${hint ? `: ${hint}` : ""}`;
    }
    this.draw();
  }

  /** Colours both maps on one scale, with the colour map of their thumbnails. */
  private paint(): void {
    const maps = this.sides.flatMap((one) => (one && "values" in one ? [one.values.values] : []));
    const ends = maps.map((values) => quantiles(values.filter((depth) => depth > 0), [0.01, 0.99]));
    const low = Math.min(...ends.map(([end]) => end!));
    const high = Math.max(...ends.map(([, end]) => end!));
    if (maps.length > 0) this.scale.textContent = `turbo, ${metres(low)} to ${metres(high)}${maps.length > 1 ? ", the same for both" : ""}`;
    this.painted = this.sides.map((one) => {
      if (!one || "picture" in one) return one?.picture ?? null;
      const { width, height, values } = one.values;
      const canvas = h("canvas", { width, height });
      const context = canvas.getContext("2d")!;
      const pixels = context.createImageData(width, height);
      paint(values, table("turbo"), low, high, pixels.data);
      context.putImageData(pixels, 0, 0);
      return canvas;
    });
  }

  private draw(): void {
    const size = this.painted.find((one) => one) as { width: number; height: number } | null | undefined;
    const context = this.canvas.getContext("2d")!;
    const room = this.area.getBoundingClientRect();
    if (!size || room.width === 0) return context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    const scale = Math.min(room.width / size.width, room.height / size.height);
    const [width, height] = [size.width * scale, size.height * scale];
    this.canvas.style.width = `${width}px`;
    this.canvas.style.height = `${height}px`;
    sized(this.canvas, width, height);
    const boundary = (Number(this.share.value) / 1000) * this.canvas.width;
    this.canvas.setAttribute("aria-label", `${this.labels[0].textContent} on the left, ${this.labels[1].textContent} on the right`);
    context.imageSmoothingEnabled = scale < 4;
    this.painted.forEach((one, i) => {
      context.save();
      context.beginPath();
      context.rect(i === 0 ? 0 : boundary, 0, i === 0 ? boundary : this.canvas.width, this.canvas.height);
      context.clip();
      context.clearRect(0, 0, this.canvas.width, this.canvas.height);
      if (one) context.drawImage(one, 0, 0, this.canvas.width, this.canvas.height);
      context.restore();
    });
    context.fillStyle = "white";
    context.fillRect(boundary - 1, 0, 2, this.canvas.height);
  }
}

async function side(service: Service, address: string): Promise<Side> {
  const contents = await service.file(address);
  const values = npy.read(await contents.arrayBuffer());
  if (values) return { values };
  const picture = await createImageBitmap(contents).catch(() => null);
  if (!picture) throw new Error(`${address} holds neither a map nor a picture`);
  return { picture };
}
