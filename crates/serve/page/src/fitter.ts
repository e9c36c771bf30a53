// Fits the map when points change: depth at once, slower results once the points have not changed for a moment.

import { Latest } from "./model/latest.ts";
import type { Layers } from "./model/layers.ts";
import { median, quantiles, range, rootMeanSquare } from "./model/numbers.ts";
import { sampled, subset } from "./model/points.ts";
import type { Draft } from "./model/settings.ts";
import { ServiceError, type Asked, type Service } from "./service.ts";
import type { Answer, Scene, Store } from "./state.ts";

const MOMENT = 140;
const QUICK: Asked[] = ["depth"];
const ALL: Asked[] = ["depth", "standard_deviation", "outliers"];

interface Job {
  readonly scene: Scene;
  readonly draft: Draft;
  readonly asked: Asked[];
}

export class Fitter {
  private timer = 0;
  private readonly latest = new Latest<Job, Answer>(
    (job) => this.run(job),
    (answer, job, waiting) => this.show(answer, job, waiting),
    (error, job) => {
      if (job.scene.file !== this.store.state.scene?.file) return;
      this.store.set({ fitting: false });
      this.failed(error);
    },
  );

  constructor(
    private readonly service: Service,
    private readonly store: Store,
    /** Posts the image again after the service has dropped it. */
    private readonly renew: (scene: Scene) => Promise<Scene>,
    private readonly failed: (error: unknown) => void,
  ) {}

  /** Fits the current draft. */
  request(): void {
    clearTimeout(this.timer);
    const { scene, draft, view } = this.store.state;
    if (!scene) return this.latest.clear();
    if (draft.points.length === 0) {
      this.latest.clear();
      return this.store.set({ answer: null, fitting: false });
    }
    this.store.set({ fitting: true });
    const deviation = view.layer === "deviation" || view.cloud === "deviation" || view.cut !== null;
    this.latest.request({ scene, draft, asked: deviation ? ["depth", "standard_deviation"] : QUICK });
  }

  private async run({ scene, draft, asked }: Job): Promise<Answer> {
    const started = performance.now();
    const used = subset(draft.points, draft.count);
    const indices = draft.points.flatMap((_, i) => (used[i] ? [i] : []));
    const sent = indices.map((i) => draft.points[i]!);
    const layers = await this.patiently(scene, (id) => this.service.fit(id, sent, draft.fit, asked));
    return summary(layers, draft, indices, (performance.now() - started) / 1000, this.store.state.answer);
  }

  /** Tries once more if the image has expired, or if the service is busy, after the delay that it names (at most 5 s). */
  private async patiently<T>(scene: Scene, ask: (id: string) => Promise<T>): Promise<T> {
    const known = this.store.state.scene;
    const id = known && known.file === scene.file ? known.id : scene.id;
    try {
      return await ask(id);
    } catch (error) {
      if (!(error instanceof ServiceError)) throw error;
      if (error.status === 404) return ask((await this.renew(scene)).id);
      if (error.status !== 429 && error.status !== 503) throw error;
      await new Promise((resolve) => setTimeout(resolve, 1000 * Math.min(5, error.retryAfter ?? 1)));
      return ask(id);
    }
  }

  private show(answer: Answer, job: Job, waiting: boolean): void {
    const { scene, draft } = this.store.state;
    if (scene?.file !== job.scene.file || draft.points.length === 0) return;
    this.store.set({ answer, fitting: waiting || job.asked !== ALL });
    if (waiting || job.asked === ALL) return;
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => {
      const { scene, draft } = this.store.state;
      if (scene && draft.points.length > 0) this.latest.request({ scene, draft, asked: ALL });
    }, MOMENT);
  }
}

export function summary(layers: Layers, draft: Draft, indices: readonly number[], seconds: number, before: Answer | null): Answer {
  const { width, height, depth } = layers;
  const fitted = draft.points.map(() => null as Layers["points"][number] | null);
  for (const point of layers.points) {
    const index = indices[point.index];
    if (index !== undefined) fitted[index] = point;
  }
  const errors = draft.points.flatMap((point, i) =>
    fitted[i] || indices.length === draft.points.length ? [] : [sampled(depth, width, height, point.u, point.v) - point.depth],
  );
  const same = before?.layers.depth.length === depth.length;
  const deviation = layers.deviation ?? (same ? before.deviation : null);
  const [low, high] = range(depth);
  const [near, middle, far] = quantiles(depth, [0.01, 0.5, 0.99]);
  const [middleDeviation, highDeviation] =
    layers.deviation || !same ? [median(deviation ?? new Float32Array()), quantiles(deviation ?? [], [0.98])[0]] : [before.middleDeviation, before.highDeviation];
  return {
    draft, layers, fitted, deviation, seconds, low, high,
    stale: !layers.deviation,
    near: near!,
    middle: middle!,
    far: far!,
    middleDeviation,
    highDeviation: highDeviation!,
    heldOut: rootMeanSquare(errors),
  };
}
