// The map as a point cloud that can be turned, moved and magnified; sparse points can be dragged along their rays.

import type { App } from "../app.ts";
import { check, h, iconButton, segments, sized, slider } from "../dom.ts";
import { table } from "../model/colours.ts";
import { flyingPixels } from "../model/flying.ts";
import { metres } from "../model/numbers.ts";
import type { Point } from "../model/points.ts";
import { CLOUDS, MEASURED, ORBIT, type Orbit, type View } from "../model/settings.ts";
import type { Answer, State } from "../state.ts";
import type { Intrinsics } from "../service.ts";
import { colour, depthRange, isOutlier, scale } from "./marks.ts";
import { eye, nearer, projected, shifted, turned, type Eye } from "./matrix.ts";
import { Renderer, strideOf } from "./renderer.ts";

/** Steps of the slider that limits the standard deviation; the last sets no limit. */
const STEPS = 100;
/** Milliseconds from drawing to the next frame above which drawing counts as slow. */
const SLOW = 32;
/** Number of pixels sampled to find whether any is in sight. */
const SAMPLE = 2000;
const MARK: [number, number, number] = [1, 0.42, 0.1];

export class Cloud {
  readonly element: HTMLElement;
  private readonly canvas = h("canvas", { "aria-hidden": "true" });
  private readonly area: HTMLDivElement;
  private readonly missing = h("p", { class: "missing", role: "status", hidden: true });
  private readonly source = segments("Colours of the cloud", [["image", "Image"], ["depth", "Depth"], ["deviation", "Deviation"]], (cloud: (typeof CLOUDS)[number]) =>
    this.app.look({ cloud }));
  private readonly cut = slider({
    label: "Cut at a deviation", steps: STEPS,
    text: (step) => (step === STEPS ? "off" : `≤ ${metres(this.cutOf(step))}`),
    change: (step) => this.app.look({ cut: step === STEPS ? null : this.cutOf(step) }),
  });
  private readonly flying = check("Leave out flying pixels",
    "Those between the surfaces at a depth edge, where there is nothing", (left) => this.app.look({ flying: !left }));
  private readonly measured = check("Fade what is not measured",
    "Pixels whose standard deviation is above a tenth of their depth: pale here, and left out of the PLY", (left) => this.app.look({ unmeasured: !left }));
  private pixels: Pixels | null = null;
  private renderer: Renderer | null = null;
  private drawn: unknown[] = [];
  private middle = 0;
  private middleOf: unknown = null;
  private eye: Eye | null = null;
  /** Whether drawing takes longer than SLOW; the cloud is then thinned out while it moves. */
  private slow = false;
  private readonly contacts = new Map<number, [number, number]>();
  private pulled: { index: number; gesture: string } | null = null;

  constructor(private readonly app: App) {
    this.area = h("div", {
      class: "area", tabindex: "0", role: "application", "aria-roledescription": "point cloud",
      "aria-label": "Point cloud. Arrow keys turn it, with Shift they move it, plus and minus magnify, 0 resets the view.",
      onkeydown: (event: KeyboardEvent) => this.key(event),
    }, this.canvas, this.missing);
    const reset = iconButton("home", "Reset the view", () => this.orbit(ORBIT));
    this.element = h("section", { class: "pane cloud", "aria-label": "Point cloud" },
      h("header", {}, h("h2", {}, "Cloud"), this.source.element, reset),
      this.area,
      h("footer", {}, this.cut.element, this.flying.element, this.measured.element));
    this.start();
    this.listen();
    new ResizeObserver(() => this.redraw()).observe(this.area);
  }

  private start(): void {
    const gl = this.canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: true });
    try {
      this.renderer = gl && new Renderer(gl);
    } catch {
      this.renderer = null;
    }
    this.say(this.renderer ? null : "This browser has no WebGL 2, which the cloud needs. The map is not affected.");
  }

  private say(text: string | null): void {
    this.missing.hidden = text === null;
    if (this.missing.textContent !== text) this.missing.textContent = text ?? "";
  }

  redraw(): void {
    this.drawn = [];
    this.show(this.app.store.state);
  }

  show(state: State): void {
    const { answer, view, draft, used, selected, cursor, scene, fitting } = state;
    this.source.set(view.cloud);
    this.flying.set(!view.flying);
    this.measured.set(!view.unmeasured);
    const high = answer?.highDeviation ?? 1;
    this.cut.set(view.cut === null ? STEPS : Math.min(STEPS - 1, Math.round(STEPS * Math.sqrt(view.cut / high))));
    const { clientWidth: width, clientHeight: height } = this.area;
    const wanted = [answer, view, draft, used, selected, cursor, scene, fitting, width, height];
    if (!this.renderer || wanted.every((part, i) => part === this.drawn[i])) return;
    this.drawn = wanted;
    this.draw(state, this.renderer, width, height);
  }

  private draw(state: State, renderer: Renderer, width: number, height: number): void {
    const { answer, view, scene } = state;
    this.canvas.hidden = !answer;
    if (!answer) this.say(null);
    if (!answer || !scene || width === 0) return;
    // The target stays fixed while points move, unless the scale of the depths changes by more than 1.5.
    const factor = answer.middle / this.middle;
    if (this.middleOf !== scene.file || !(factor < 1.5 && factor > 1 / 1.5)) [this.middle, this.middleOf] = [answer.middle, scene.file];
    const density = sized(this.canvas, width, height);
    const camera = this.app.camera();
    this.eye = eye(view.orbit, this.middle, this.tangent(), width, height);
    const pixels = this.chosen(answer, camera, view);
    renderer.load(answer.layers.width, answer.layers.height, pixels.depth, answer.deviation, scene.picture);
    const deviation = view.cloud === "deviation";
    const look = {
      eye: { ...this.eye, focal: this.eye.focal * density },
      camera, density,
      thinning: this.slow && (state.fitting || this.contacts.size > 0) ? 3 : 1,
      source: CLOUDS.indexOf(view.cloud) as 0 | 1 | 2,
      colours: table(deviation ? "magma" : view.colours),
      range: deviation ? ([0, answer.highDeviation] as const) : depthRange(view, answer),
      cut: view.cut ?? 3e38,
      measured: view.unmeasured ? 3e38 : MEASURED,
    };
    renderer.draw(look, this.marks(state), this.lines(state));
    const share = (part: number) => `${(100 * part).toFixed(1)} %`;
    this.flying.note(view.flying ? "" : share(pixels.flying));
    this.measured.note(view.unmeasured || !answer.deviation ? "" : share(pixels.unmeasured));
    this.say(this.why(pixels));
    if (look.thinning > 1) return;
    const started = performance.now();
    requestAnimationFrame(() => (this.slow = performance.now() - started > SLOW));
  }

  /** The pixels of the cloud, computed again only if their inputs have changed. */
  private chosen(answer: Answer, camera: Intrinsics, { flying, unmeasured, cut }: View): Pixels {
    const { depth, width, height } = answer.layers;
    const deviation = cut === null && unmeasured ? null : answer.deviation;
    const key = [depth, flying || camera.fx, flying || camera.fy, unmeasured, cut, deviation];
    if (this.pixels && key.every((part, i) => part === this.pixels!.key[i])) return this.pixels;
    const stride = strideOf(width, height);
    const out = flying ? null : flyingPixels(depth, width, height, camera, stride);
    const most = unmeasured ? Infinity : MEASURED;
    const kept = out ? depth.slice() : depth;
    const drawn: number[] = [];
    let [all, left, unsure] = [0, 0, 0];
    for (let v = 0; v < height; v += stride) {
      for (let i = v * width; i < (v + 1) * width; i += stride) {
        all++;
        if (deviation && deviation[i]! > most * depth[i]!) unsure++;
        if (out?.[i]) {
          left++;
          kept[i] = 0;
        } else if (cut === null || !deviation || !(deviation[i]! > cut)) drawn.push(i);
      }
    }
    const step = Math.max(1, Math.floor(drawn.length / SAMPLE));
    const sample = drawn.filter((_, at) => at % step === 0).map((i) => ({ u: i % width, v: Math.floor(i / width), depth: depth[i]! }));
    return (this.pixels = { key, depth: kept, flying: left / all, unmeasured: unsure / all, isCut: cut !== null, sample });
  }

  /** The reason why no pixel is visible; null if one is. */
  private why({ sample, isCut }: Pixels): string | null {
    if (sample.length === 0) return isCut ? "All pixels are above the cut. Move its slider to the right." : "All pixels are left out.";
    const { clientWidth: width, clientHeight: height } = this.area;
    const inSight = sample.some((point) => {
      const [x, y] = this.screen(point) ?? [-1, -1];
      return x >= 0 && x <= width && y >= 0 && y <= height;
    });
    return inSight ? null : "The cloud is out of sight. Reset the view, with 0 or the button above.";
  }

  /** Tangent of half the vertical field of view. */
  private tangent(): number {
    const { scene } = this.app.store.state;
    const { fx, fy } = this.app.camera();
    const { clientWidth: width, clientHeight: height } = this.area;
    return scene ? 1.12 * Math.max(scene.height / 2 / fy, ((scene.width / 2 / fx) * height) / Math.max(1, width)) : 0.5;
  }

  private place({ u, v, depth }: Point): [number, number, number] {
    const { fx, fy, cx, cy } = this.app.camera();
    return [((u - cx) / fx) * depth, ((v - cy) / fy) * depth, depth];
  }

  private marks({ draft, used, answer, view, selected, cursor }: State): Float32Array {
    const values: number[] = [];
    const shown = scale(view, answer);
    const size = draft.points.length > 2000 ? 4 : draft.points.length > 100 ? 6 : 9;
    if (view.marks !== "none") {
      draft.points.forEach((point, i) => {
        if (!used[i]) return;
        const fitted = answer?.fitted[i] ?? null;
        const tint = i === selected || isOutlier(fitted) ? MARK : rgb(view.marks === "outlier" ? "" : colour(shown, fitted, ""));
        values.push(...this.place(point), i === selected ? 13 : size, ...tint, 1);
      });
    }
    const depth = cursor && this.app.depthAt(cursor.u, cursor.v);
    if (cursor && depth) values.push(...this.place({ ...cursor, depth }), 9, ...MARK, 1);
    return Float32Array.from(values);
  }

  /** The error bar at the cursor, along the viewing ray. */
  private lines({ cursor, answer }: State): Float32Array {
    const deviation = cursor && answer?.deviation?.[cursor.v * answer.layers.width + cursor.u];
    const depth = cursor && this.app.depthAt(cursor.u, cursor.v);
    if (!cursor || !depth || !deviation) return new Float32Array();
    const end = (sign: number) => [...this.place({ ...cursor, depth: Math.max(0.01 * depth, depth + sign * deviation) }), 1, ...MARK, 1];
    return Float32Array.from([...end(-1), ...end(1)]);
  }

  private cutOf = (step: number): number => (this.app.store.state.answer?.highDeviation ?? 1) * (Math.max(1, step) / STEPS) ** 2;

  private orbit(orbit: Orbit): void {
    this.app.look({ orbit });
  }

  private listen(): void {
    const { area } = this;
    area.addEventListener("contextmenu", (event) => event.preventDefault());
    area.addEventListener("pointerdown", (event) => {
      area.setPointerCapture(event.pointerId);
      this.contacts.set(event.pointerId, [event.offsetX, event.offsetY]);
      const index = this.contacts.size === 1 && event.button === 0 ? this.hit(event.offsetX, event.offsetY) : null;
      this.pulled = index === null ? null : { index, gesture: `pull ${Math.random()}` };
      if (index !== null) this.app.select(index);
    });
    area.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"] as const) {
      area.addEventListener(name, (event) => {
        this.contacts.delete(event.pointerId);
        if (this.pulled) this.app.seal();
        this.pulled = null;
        if (this.slow) this.redraw();
      });
    }
    area.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.orbit(nearer(this.app.store.state.view.orbit, Math.exp(-event.deltaY * (event.deltaMode === 1 ? 0.04 : 0.0015))));
    }, { passive: false });
    this.canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    this.canvas.addEventListener("webglcontextrestored", () => {
      this.start();
      this.redraw();
    });
  }

  private move(event: PointerEvent): void {
    const before = this.contacts.get(event.pointerId);
    if (!before) return;
    const box = this.area.getBoundingClientRect();
    const at: [number, number] = [event.clientX - box.left, event.clientY - box.top];
    const other = [...this.contacts].find(([id]) => id !== event.pointerId)?.[1];
    this.contacts.set(event.pointerId, at);
    const [dx, dy] = [at[0] - before[0], at[1] - before[1]];
    const height = this.area.clientHeight;
    const { orbit } = this.app.store.state.view;
    if (other) {
      const apart = ([x, y]: [number, number]) => Math.hypot(x - other[0], y - other[1]) || 1;
      this.orbit(nearer(shifted(orbit, dx / 2 / height, dy / 2 / height, this.tangent()), apart(at) / apart(before)));
    } else if (this.pulled) this.pull(this.pulled.index, dx, dy, this.pulled.gesture);
    else if (event.buttons & 6 || event.shiftKey) this.orbit(shifted(orbit, dx / height, dy / height, this.tangent()));
    else this.orbit(turned(orbit, dx / height, dy / height));
  }

  private screen(point: Point): [number, number] | null {
    return this.eye && projected(this.eye, this.place(point), this.area.clientWidth, this.area.clientHeight);
  }

  private hit(x: number, y: number): number | null {
    const { draft, used, view } = this.app.store.state;
    if (view.marks === "none" || draft.points.length > 2000) return null;
    let [best, least]: [number | null, number] = [null, 64];
    draft.points.forEach((point, i) => {
      const at = used[i] ? this.screen(point) : null;
      const away = at ? (at[0] - x) ** 2 + (at[1] - y) ** 2 : Infinity;
      if (away < least) [best, least] = [i, away];
    });
    return best;
  }

  /** Moves a point along its ray by the component of the drag along the ray on the screen. */
  private pull(index: number, dx: number, dy: number, gesture: string): void {
    const point = this.app.store.state.draft.points[index];
    const from = point && this.screen(point);
    const step = point && 0.01 * point.depth;
    const to = point && this.screen({ ...point, depth: point.depth + step! });
    if (!point || !from || !to || !step) return;
    const ray = [to[0] - from[0], to[1] - from[1]] as const;
    const length = ray[0] ** 2 + ray[1] ** 2;
    // The ray points at the viewer: its direction on the screen is undefined.
    if (length < 0.02) return;
    const depth = point.depth + (step * (dx * ray[0] + dy * ray[1])) / length;
    if (depth > 0.05 * point.depth) this.app.change(index, { depth: Number(depth.toPrecision(5)) }, gesture);
  }

  private key(event: KeyboardEvent): void {
    const { orbit } = this.app.store.state.view;
    const [x, y] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key] ?? [0, 0];
    if (event.ctrlKey || event.metaKey) return;
    if (x || y) this.orbit(event.shiftKey ? shifted(orbit, x! * 0.04, y! * 0.04, this.tangent()) : turned(orbit, x! * 0.03, y! * 0.03));
    else if (event.key === "+" || event.key === "=") this.orbit(nearer(orbit, 1.1));
    else if (event.key === "-") this.orbit(nearer(orbit, 1 / 1.1));
    else if (event.key === "0" || event.key === "Home") this.orbit(ORBIT);
    else return;
    event.preventDefault();
  }
}

interface Pixels {
  readonly key: readonly unknown[];
  /** Depths of the map; 0 at flying pixels that are left out. */
  readonly depth: Float32Array;
  /** Shares of flying pixels and of pixels that count as not measured, among all that could be drawn. */
  readonly flying: number;
  readonly unmeasured: number;
  readonly isCut: boolean;
  /** A regular sample of the pixels kept. */
  readonly sample: readonly Point[];
}

function rgb(text: string): [number, number, number] {
  const numbers = /^rgb\((\d+) (\d+) (\d+)\)$/.exec(text);
  return numbers ? [Number(numbers[1]) / 255, Number(numbers[2]) / 255, Number(numbers[3]) / 255] : [0.91, 0.91, 0.92];
}
