// The image with its map and points: drawing, and the actions of clicks, drags and keys.

import type { App } from "../app.ts";
import { h, inks, sized } from "../dom.ts";
import { paint, table } from "../model/colours.ts";
import { metres } from "../model/numbers.ts";
import type { State } from "../state.ts";
import { Editor } from "./editor.ts";
import { Frame } from "./frame.ts";
import { colour, depthRange, isOutlier, scale } from "./marks.ts";
import { Pointers } from "./pointers.ts";

export class Stage {
  readonly frame = new Frame();
  readonly element: HTMLElement;
  private readonly canvas = h("canvas", { "aria-hidden": "true" });
  private readonly said = h("p", { class: "hidden", "aria-live": "polite" });
  private readonly editor: Editor;
  private readonly map = document.createElement("canvas");
  private painted: unknown[] = [];
  private drawn: unknown[] = [];
  private keyboard = false;

  constructor(
    private readonly app: App,
    private readonly moved: () => void,
  ) {
    this.editor = new Editor(app, () => this.area.focus());
    this.area = h("div", {
      class: "area",
      tabindex: "0",
      role: "application",
      "aria-roledescription": "image with points",
      "aria-label": "Image. Arrow keys move the cursor, Enter sets a depth there, Delete removes the point.",
      onkeydown: (event: KeyboardEvent) => this.key(event),
      onfocus: () => this.focus(),
      onblur: () => (this.keyboard = false),
    }, this.canvas);
    this.element = h("div", { class: "stage" }, this.area, this.said, this.editor.element);
    new Pointers(this.area, {
      hit: (x, y, reach) => this.hit(x, y, reach),
      press: () => this.editor.close(),
      hover: (x, y) => this.hover(x, y),
      leave: () => !this.keyboard && this.app.point(null),
      click: (x, y, hit) => this.click(x, y, hit),
      drag: (hit, x, y) => this.drag(hit, x, y),
      drop: () => this.app.seal(),
      pan: (dx, dy) => this.zoomed(() => this.frame.move(dx, dy)),
      zoom: (factor, x, y) => this.zoomed(() => this.frame.magnify(factor, x, y)),
      holds: () => this.frame.magnified,
    });
    new ResizeObserver(() => this.redraw()).observe(this.area);
  }

  private readonly area: HTMLDivElement;

  show(state: State): void {
    const { scene, answer, view, draft, selected, cursor, pending } = state;
    if (!scene) return this.editor.close();
    this.editor.show(state, this.frame);
    const wanted = [scene, answer, view, draft, state.used, selected, cursor, pending, this.area.clientWidth, this.area.clientHeight, this.frame.scale];
    if (wanted.every((part, i) => part === this.drawn[i])) return;
    this.drawn = wanted;
    this.draw(state);
  }

  redraw(): void {
    this.drawn = [];
    this.painted = [];
    this.show(this.app.store.state);
    this.moved();
  }

  private zoomed(change: () => void): void {
    change();
    this.drawn = [];
    this.show(this.app.store.state);
    this.moved();
  }

  private draw(state: State): void {
    const { scene, answer, view, cursor, selected, pending } = state;
    if (!scene) return;
    const [width, height] = [this.area.clientWidth, this.area.clientHeight];
    if (width === 0) return;
    this.frame.resize(width, height, scene.width, scene.height);
    const density = sized(this.canvas, width, height);
    const context = this.canvas.getContext("2d")!;
    context.setTransform(density, 0, 0, density, 0, 0);
    context.clearRect(0, 0, width, height);
    context.imageSmoothingEnabled = this.frame.scale < 4;
    context.imageSmoothingQuality = "high";
    const box = this.frame.box();
    if (scene.picture) context.drawImage(scene.picture, ...box);
    else context.strokeRect(...box);
    if (answer && view.layer !== "none" && this.paint(state)) {
      context.globalAlpha = view.opacity;
      context.drawImage(this.map, ...box);
      context.globalAlpha = 1;
    }
    const { mark } = inks(this.element);
    if (cursor) this.crosshair(context, cursor.u, cursor.v, box);
    this.points(context, state, mark);
    const chosen = selected === null ? undefined : state.draft.points[selected];
    if (chosen) ring(context, this.frame.x(chosen.u), this.frame.y(chosen.v), 9, 2.5, mark);
    if (pending) {
      context.setLineDash([3, 3]);
      ring(context, this.frame.x(pending.u), this.frame.y(pending.v), 6, 1.5, mark);
      context.setLineDash([]);
    }
  }

  /** Colours the map; false if the chosen layer is not available yet. */
  private paint({ answer, view }: State): boolean {
    if (!answer) return false;
    const deviation = view.layer === "deviation";
    const values = deviation ? answer.deviation : answer.layers.depth;
    if (!values) return false;
    const { width, height } = answer.layers;
    const [low, high] = deviation ? [0, answer.highDeviation] : depthRange(view, answer);
    const wanted = [values, low, high, view.colours, deviation];
    if (wanted.every((part, i) => part === this.painted[i])) return true;
    this.painted = wanted;
    if (this.map.width !== width || this.map.height !== height) [this.map.width, this.map.height] = [width, height];
    const context = this.map.getContext("2d")!;
    const pixels = context.createImageData(width, height);
    paint(values, table(deviation ? "magma" : view.colours), low, high, pixels.data);
    context.putImageData(pixels, 0, 0);
    return true;
  }

  private crosshair(context: CanvasRenderingContext2D, u: number, v: number, [left, top, width, height]: [number, number, number, number]): void {
    const [x, y] = [Math.round(this.frame.x(u)) + 0.5, Math.round(this.frame.y(v)) + 0.5];
    context.lineWidth = 1;
    for (const [style, dash] of [["rgb(0 0 0 / 0.55)", []], ["rgb(255 255 255 / 0.85)", [3, 3]]] as const) {
      context.strokeStyle = style;
      context.setLineDash([...dash]);
      context.beginPath();
      context.moveTo(left, y);
      context.lineTo(x - 6, y);
      context.moveTo(x + 6, y);
      context.lineTo(left + width, y);
      context.moveTo(x, Math.max(top, y - 14));
      context.lineTo(x, y - 6);
      context.moveTo(x, y + 6);
      context.lineTo(x, Math.min(top + height, y + 14));
      context.stroke();
    }
    context.setLineDash([]);
  }

  private points(context: CanvasRenderingContext2D, { draft, used, answer, view }: State, mark: string): void {
    if (view.marks === "none") return;
    const shown = scale(view, answer);
    const radius = this.radius(draft.points.length);
    context.globalAlpha = view.marksOpacity;
    draft.points.forEach((point, i) => {
      const [x, y] = [this.frame.x(point.u), this.frame.y(point.v)];
      if (!used[i]) return ring(context, x, y, Math.max(1.5, radius - 0.5), 0.75, "rgb(255 255 255 / 0.6)");
      const fitted = answer?.fitted[i] ?? null;
      const wrong = isOutlier(fitted);
      context.beginPath();
      context.arc(x, y, radius, 0, 2 * Math.PI);
      context.fillStyle = view.marks === "outlier" ? (wrong ? mark : "#e9eaec") : colour(shown, fitted, "#e9eaec");
      context.fill();
      context.lineWidth = radius > 3 ? 1.25 : 0.75;
      context.strokeStyle = "rgb(0 0 0 / 0.75)";
      context.stroke();
      if (wrong) cross(context, x, y, radius + 4, mark);
    });
    context.globalAlpha = 1;
  }

  private radius(points: number): number {
    const room = Math.sqrt((this.area.clientWidth * this.area.clientHeight) / Math.max(1, points));
    return Math.min(5, Math.max(1.4, room * 0.12)) * (this.frame.magnified ? Math.min(2, Math.sqrt(this.frame.scale)) : 1);
  }

  private hit(x: number, y: number, reach: number): number | null {
    const { draft, used, view, selected } = this.app.store.state;
    if (view.marks === "none") return null;
    let [best, least]: [number | null, number] = [null, reach * reach];
    draft.points.forEach((point, i) => {
      const [dx, dy] = [this.frame.x(point.u) - x, this.frame.y(point.v) - y];
      const away = used[i] ? (dx * dx + dy * dy) * (i === selected ? 0.5 : 1) : Infinity;
      if (away < least) [best, least] = [i, away];
    });
    return best;
  }

  private hover(x: number, y: number): void {
    this.keyboard = false;
    if (!this.frame.contains(x, y)) return this.app.point(null);
    const { u, v } = this.frame.pixel(x, y);
    this.app.point({ u: Math.round(u), v: Math.round(v) });
  }

  private click(x: number, y: number, hit: number | null): void {
    if (hit === null && !this.frame.contains(x, y)) return this.app.select(null);
    const { u, v } = this.frame.pixel(x, y);
    this.set(hit, Math.round(u), Math.round(v));
  }

  /** Edits the point `hit`, or asks for the depth of a new one at a pixel. */
  private set(hit: number | null, u: number, v: number): void {
    this.app.select(hit);
    if (hit === null) this.editor.ask({ u, v });
    else this.editor.open(hit);
    this.show(this.app.store.state);
  }

  private drag(hit: number, x: number, y: number): void {
    const { u, v } = this.frame.pixel(x, y);
    this.app.select(hit);
    this.app.change(hit, { u: Math.round(u * 10) / 10, v: Math.round(v * 10) / 10 }, `move ${hit}`);
    this.app.point({ u: Math.round(u), v: Math.round(v) });
  }

  private focus(): void {
    const { scene, cursor } = this.app.store.state;
    if (!scene || cursor || !this.area.matches(":focus-visible")) return;
    this.keyboard = true;
    this.app.point({ u: Math.floor(scene.width / 2), v: Math.floor(scene.height / 2) });
  }

  private key(event: KeyboardEvent): void {
    const { scene, cursor, selected, draft } = this.app.store.state;
    if (!scene || event.ctrlKey || event.metaKey) return;
    const at = cursor ?? { u: Math.floor(scene.width / 2), v: Math.floor(scene.height / 2) };
    const step = event.shiftKey ? 10 : 1;
    const arrow = ARROWS[event.key];
    const near = selected ?? this.hit(this.frame.x(at.u), this.frame.y(at.v), 9);
    this.keyboard = true;
    if (arrow && event.altKey && selected !== null) {
      const point = draft.points[selected]!;
      this.app.change(selected, { u: point.u + arrow[0] * step, v: point.v + arrow[1] * step }, `move ${selected}`);
    } else if (arrow) {
      const u = Math.min(scene.width - 1, Math.max(0, at.u + arrow[0] * step));
      const v = Math.min(scene.height - 1, Math.max(0, at.v + arrow[1] * step));
      this.app.select(null);
      this.go(u, v);
    } else if (event.key === "Enter" || event.key === " ") this.set(near, at.u, at.v);
    else if ((event.key === "Delete" || event.key === "Backspace") && near !== null) this.remove(near);
    else if ((event.key === "n" || event.key === "p") && draft.points.length > 0) {
      const many = draft.points.length;
      const next = selected === null ? (event.key === "n" ? 0 : many - 1) : (selected + (event.key === "n" ? 1 : many - 1)) % many;
      this.app.select(next);
      this.go(Math.round(draft.points[next]!.u), Math.round(draft.points[next]!.v));
    } else if (event.key === "Escape") this.app.select(null);
    else if (event.key === "+" || event.key === "=") this.zoomed(() => this.frame.magnify(1.25, this.frame.x(at.u), this.frame.y(at.v)));
    else if (event.key === "-") this.zoomed(() => this.frame.magnify(0.8, this.frame.x(at.u), this.frame.y(at.v)));
    else return;
    event.preventDefault();
  }

  private remove(index: number): void {
    this.app.remove(index);
    this.said.textContent = `point ${index + 1} removed`;
  }

  private go(u: number, v: number): void {
    this.app.point({ u, v });
    if (this.frame.magnified) this.zoomed(() => this.frame.reveal(u, v));
    const depth = this.app.depthAt(u, v);
    const { answer } = this.app.store.state;
    const deviation = answer?.deviation?.[v * answer.layers.width + u];
    this.said.textContent = `column ${u}, row ${v}${depth === null ? "" : `, depth ${metres(depth)}`}${deviation === undefined ? "" : `, give or take ${metres(deviation)}`}`;
  }
}

const ARROWS: Record<string, readonly [number, number]> = {
  ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1],
};

function ring(context: CanvasRenderingContext2D, x: number, y: number, radius: number, width: number, colour: string): void {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.lineWidth = width + 2;
  context.strokeStyle = "rgb(0 0 0 / 0.4)";
  context.stroke();
  context.lineWidth = width;
  context.strokeStyle = colour;
  context.stroke();
}

function cross(context: CanvasRenderingContext2D, x: number, y: number, reach: number, colour: string): void {
  for (const [width, style] of [[4, "rgb(0 0 0 / 0.55)"], [2, colour]] as const) {
    context.lineWidth = width;
    context.strokeStyle = style;
    context.beginPath();
    for (const [sx, sy] of [[1, 1], [1, -1], [-1, 1], [-1, -1]] as const) {
      context.moveTo(x + (sx * reach) / 2.6, y + (sy * reach) / 2.6);
      context.lineTo(x + (sx * reach) / 1.2, y + (sy * reach) / 1.2);
    }
    context.stroke();
  }
}
