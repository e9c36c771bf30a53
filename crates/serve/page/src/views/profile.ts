// Depth along the row of the cursor, with its error band and nearby points. Columns are aligned with those of the image.

import type { App } from "../app.ts";
import { h, inks, sized } from "../dom.ts";
import { quantiles, tick, ticks } from "../model/numbers.ts";
import type { State } from "../state.ts";
import type { Frame } from "./frame.ts";
import { isOutlier } from "./marks.ts";

/** Largest distance of points drawn with the row, relative to the height of the image. */
const NEAR = 0.02;
const MARGIN = { top: 14, bottom: 22 };

export class Profile {
  readonly element: HTMLElement;
  private readonly canvas = h("canvas", { role: "img" });
  private readonly title = h("span", { class: "where" });
  private drawn: unknown[] = [];

  constructor(
    private readonly app: App,
    private readonly frame: Frame,
  ) {
    const area = h("div", { class: "area" }, this.canvas);
    this.element = h("section", { class: "pane profile", "aria-label": "Section" },
      h("header", {}, h("h2", {}, "Section"), this.title), area);
    new ResizeObserver(() => this.redraw()).observe(area);
    this.canvas.addEventListener("pointermove", (event) => this.hover(event));
  }

  redraw(): void {
    this.drawn = [];
    this.show(this.app.store.state);
  }

  show(state: State): void {
    const row = this.row(state);
    const { answer, draft, used, view, cursor } = state;
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement!;
    const wanted = [answer, draft, used, row, cursor?.u, view.theme, view.low, view.high, width, height, this.frame.scale, this.frame.x(0)];
    if (wanted.every((part, i) => part === this.drawn[i])) return;
    this.drawn = wanted;
    this.title.textContent = answer ? `depth along row ${row}, ± one standard deviation` : "";
    const density = sized(this.canvas, width, height);
    const context = this.canvas.getContext("2d")!;
    context.setTransform(density, 0, 0, density, 0, 0);
    context.clearRect(0, 0, width, height);
    if (answer && state.scene) this.draw(context, state, row, width, height);
  }

  private row({ scene, cursor, selected, draft }: State): number {
    const chosen = selected === null ? undefined : draft.points[selected];
    const v = cursor?.v ?? chosen?.v ?? (scene ? scene.height / 2 : 0);
    return Math.min((scene?.height ?? 1) - 1, Math.max(0, Math.round(v)));
  }

  private draw(context: CanvasRenderingContext2D, state: State, row: number, width: number, height: number): void {
    const { answer, draft, used, cursor } = state;
    if (!answer) return;
    const columns = answer.layers.width;
    const depth = answer.layers.depth.subarray(row * columns, (row + 1) * columns);
    const deviation = answer.deviation?.subarray(row * columns, (row + 1) * columns);
    const { ink, quiet, line, paper, mark } = inks(this.element);
    const near = draft.points.flatMap((point, i) =>
      used[i] && Math.abs(point.v - row) <= Math.max(0.5, NEAR * answer.layers.height) ? [{ point, fitted: answer.fitted[i] }] : []);
    const [low, high] = span(depth, deviation, near.map(({ point }) => point.depth));
    const y = (metres: number) => MARGIN.top + ((high - metres) / (high - low)) * (height - MARGIN.top - MARGIN.bottom);
    const x = (u: number) => this.frame.x(u);

    context.font = "11px Inter, system-ui, sans-serif";
    context.textBaseline = "middle";
    const levels = ticks(low, high, Math.max(2, Math.floor(height / 32)));
    context.lineWidth = 1;
    for (const level of levels) {
      const at = Math.round(y(level)) + 0.5;
      context.strokeStyle = line;
      context.beginPath();
      context.moveTo(Math.max(0, x(-0.5)), at);
      context.lineTo(Math.min(width, x(columns - 0.5)), at);
      context.stroke();
    }
    if (deviation) {
      context.beginPath();
      for (let u = 0; u < columns; u++) context.lineTo(x(u), y(depth[u]! + deviation[u]!));
      for (let u = columns - 1; u >= 0; u--) context.lineTo(x(u), y(depth[u]! - deviation[u]!));
      context.globalAlpha = answer.stale ? 0.08 : 0.15;
      context.fillStyle = ink;
      context.fill();
      context.globalAlpha = 1;
    }
    context.beginPath();
    for (let u = 0; u < columns; u++) context.lineTo(x(u), y(depth[u]!));
    context.lineWidth = 1.5;
    context.lineJoin = "round";
    context.strokeStyle = ink;
    context.stroke();

    for (const { point, fitted } of near) {
      const [px, py] = [x(point.u), y(point.depth)];
      context.beginPath();
      context.arc(px, py, 3, 0, 2 * Math.PI);
      context.fillStyle = isOutlier(fitted) ? mark : paper;
      context.fill();
      context.lineWidth = 1.5;
      context.strokeStyle = isOutlier(fitted) ? mark : ink;
      context.stroke();
    }
    if (cursor) {
      const at = Math.round(x(cursor.u)) + 0.5;
      context.strokeStyle = mark;
      context.lineWidth = 1;
      context.beginPath();
      context.moveTo(at, MARGIN.top - 6);
      context.lineTo(at, height - MARGIN.bottom);
      context.stroke();
      context.beginPath();
      context.arc(at, y(depth[cursor.u] ?? NaN), 3.5, 0, 2 * Math.PI);
      context.fillStyle = mark;
      context.fill();
    }
    context.fillStyle = quiet;
    for (const level of levels) {
      const text = `${tick(level, levels)}${level === levels.at(-1) ? " m" : ""}`;
      // Beside the image if there is room; otherwise on a translucent background over the curve and band.
      const wide = context.measureText(text).width;
      const beside = x(-0.5) >= wide + 10;
      const left = beside ? x(-0.5) - wide - 6 : Math.max(2, x(-0.5) + 2);
      if (!beside) {
        context.fillStyle = paper;
        context.globalAlpha = 0.85;
        context.fillRect(left - 2, y(level) - 7, wide + 6, 14);
        context.globalAlpha = 1;
        context.fillStyle = quiet;
      }
      context.fillText(text, left + (beside ? 0 : 1), y(level));
    }
    const [first, last] = [this.frame.pixel(0, 0).u, this.frame.pixel(width, 0).u];
    context.textAlign = "center";
    const places = ticks(Math.max(0, first), Math.min(columns - 1, last), Math.max(2, Math.floor(width / 80)));
    for (const u of places) {
      const at = Math.min(width - 10, Math.max(10, x(u)));
      context.fillText(String(u), at, height - MARGIN.bottom / 2);
      context.fillRect(Math.round(x(u)), height - MARGIN.bottom, 1, 4);
    }
    context.textAlign = "left";
    this.canvas.setAttribute("aria-label", `Depth along row ${row}: ${low.toFixed(2)} to ${high.toFixed(2)} metres`);
  }

  private hover(event: PointerEvent): void {
    const { scene, cursor } = this.app.store.state;
    if (!scene) return;
    const u = Math.round(this.frame.pixel(event.offsetX, 0).u);
    if (u >= 0 && u < scene.width) this.app.point({ u, v: cursor?.v ?? this.row(this.app.store.state) });
  }
}

/** Range of depths shown: the row, its points and most of the error band. */
function span(depth: Float32Array, deviation: Float32Array | undefined, points: readonly number[]): [number, number] {
  const ends = (sign: number) => Array.from(depth, (d, i) => d + sign * (deviation?.[i] ?? 0));
  const [low] = quantiles(ends(-1), [0.02]);
  const [high] = quantiles(ends(1), [0.98]);
  const least = Math.max(0, Math.min(low!, ...depth, ...points));
  const most = Math.max(high!, ...depth, ...points);
  const room = 0.06 * (most - least) || 0.1 * most || 1;
  return [Math.max(0, least - room), most + room];
}
