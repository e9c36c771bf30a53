// Actions on the page.

import { Fitter } from "./fitter.ts";
import { sorted } from "./files.ts";
import { History } from "./model/history.ts";
import * as link from "./model/link.ts";
import { count } from "./model/numbers.ts";
import { assumed } from "./model/camera.ts";
import { sampled, subset, type Point } from "./model/points.ts";
import { DRAFT, NO_LIMIT, renewed, VIEW, type Draft, type Fit, type View } from "./model/settings.ts";
import { FORMATS, ServiceError, type Demo, type Format, type Intrinsics, type Service } from "./service.ts";
import { Store, type Notice, type Pixel, type Scene } from "./state.ts";

/** Number of points above which the map uses only this many at first; a slider raises the number. */
const EASY = 5000;

interface Opening {
  readonly image: File;
  readonly points: File | readonly Point[] | null;
  readonly camera: File | null;
  readonly demo?: string;
}

export class App {
  readonly store = new Store({
    scene: null, draft: DRAFT, used: [], answer: null, view: VIEW, selected: null, cursor: null, pending: null,
    fitting: false, waiting: null, notice: null, canUndo: false, canRedo: false,
  });
  private history = new History<Draft>(DRAFT);
  private readonly fitter: Fitter;
  /** Settings from a link whose image has not been opened yet. */
  private linked: link.Linked | null = null;
  private addressTimer = 0;

  constructor(readonly service: Service) {
    this.fitter = new Fitter(service, this.store, (scene) => this.renew(scene), (error) => this.fail(error));
  }

  // Opening

  async openFiles(files: readonly File[]): Promise<void> {
    const { image, points, camera, unknown } = await sorted(files);
    const { scene } = this.store.state;
    if (unknown.length > 0) {
      const names = unknown.map((file) => file.name).join(", ");
      this.note(`${names}: neither image, points nor camera`, "images are JPEG, PNG, WebP, TIFF, BMP, PNM; points npy, npz, csv, png, ply and more");
      if (unknown.length === files.length) return;
    }
    if (image) return this.open({ image, points, camera });
    if (!scene) return this.note("there is no image yet", "open the image first, or drop both files together");
    if (camera) return this.open({ image: scene.file, points: points ?? this.store.state.draft.points, camera });
    if (points) await this.openPoints(scene, points);
  }

  async openDemo(demo: Demo): Promise<void> {
    await this.guarded("opening the demo", async () => {
      const [image, points] = await Promise.all([this.fetched(demo.image), this.given(demo.points)]);
      await this.open({ image, points, camera: null, demo: demo.name });
    });
  }

  async openAddresses(image: string, points: string | number[][] | null, camera: string | null, name?: string | null): Promise<void> {
    await this.guarded("opening the image", async () => {
      const files = await Promise.all([this.fetched(image, name), points ? this.given(points) : null, camera ? this.fetched(camera) : null]);
      await this.open({ image: files[0], points: files[1], camera: files[2] });
    });
  }

  private async fetched(address: string, name?: string | null): Promise<File> {
    const contents = await this.service.file(address);
    const last = new URL(address, location.href).pathname.split("/").pop() || "file";
    return new File([contents], name ?? decodeURIComponent(last), { type: contents.type });
  }

  private async given(points: string | number[][]): Promise<File | Point[]> {
    if (typeof points === "string") return this.fetched(points);
    return points.map(([u, v, depth, sigma]) => ({ u: u!, v: v!, depth: depth!, ...(sigma !== undefined && { sigma }) }));
  }

  async open({ image, points, camera, demo }: Opening): Promise<void> {
    await this.guarded("computing basis functions", async () => {
      const [posted, picture] = await Promise.all([
        this.service.post(image, camera),
        createImageBitmap(image).catch(() => null),
      ]);
      const before = this.store.state.scene;
      if (before) this.service.forget(before.id);
      const { id, width, height } = posted;
      const source = demo ? { demo } : { file: image.name, width, height };
      const scene: Scene = {
        id, width, height, picture, source, name: image.name, file: image, camera: posted.camera ?? null, cameraFile: camera,
        given: [], pointsName: points instanceof File ? points.name : null, remarks: [],
      };
      if (!picture) this.note("the browser cannot show images of this kind", "the map is shown without it");
      this.store.set({ scene, answer: null, selected: null, cursor: null, pending: null });
      if (before?.file !== image) this.store.set({ view: renewed(this.store.state.view) });
      this.restart(DRAFT);
      if (points instanceof File) await this.openPoints(scene, points);
      else this.begin(scene, points ?? []);
    });
  }

  private async openPoints(scene: Scene, file: File): Promise<void> {
    await this.guarded("reading points", async () => {
      const layers = await this.service.fit(scene.id, file, this.store.state.draft.fit, ["depth"]);
      const points = layers.points.map(({ u, v, depth, sigma }) => ({ u, v, depth, ...(sigma !== null && { sigma }) }));
      this.begin({ ...scene, pointsName: file.name, remarks: layers.report.remarks ?? [] }, points);
    });
  }

  private begin(scene: Scene, given: readonly Point[]): void {
    this.store.set({ scene: { ...scene, given } });
    const wanted = this.linked;
    const same = wanted && (!wanted.source || JSON.stringify(wanted.source) === JSON.stringify(scene.source));
    const many = given.length > EASY ? EASY : null;
    this.linked = null;
    if (same) {
      this.restart({ points: wanted.points ?? given, fit: wanted.fit, count: wanted.count ?? many });
      this.store.set({ view: { ...wanted.view, theme: this.store.state.view.theme } });
      if (wanted.omitted > 0) this.note(`the link could not hold its ${count(wanted.omitted)} points`, "open their file as well");
    } else {
      this.restart({ ...this.store.state.draft, points: given, count: many });
      if (many) this.note(`${count(given.length)} points; the map uses ${count(many)} of them`, "the slider takes more, and more time");
    }
    this.fitter.request();
  }

  private async renew(scene: Scene): Promise<Scene> {
    const { id } = await this.service.post(scene.file, scene.cameraFile);
    const fresh = { ...(this.store.state.scene ?? scene), id };
    if (this.store.state.scene?.file === scene.file) this.store.set({ scene: fresh });
    return fresh;
  }

  close(): void {
    const { scene } = this.store.state;
    if (scene) this.service.forget(scene.id);
    this.store.set({ scene: null, answer: null, selected: null, cursor: null, pending: null });
    this.restart(DRAFT);
    window.history.replaceState(null, "", location.pathname);
  }

  // Points and fit

  edit(draft: Draft, gesture: string | null = null): void {
    this.history.push(draft, gesture);
    this.apply();
  }

  /** Sets the position of a new point whose depth is not accepted yet, or clears it. */
  propose = (pending: Pixel | null): void => this.store.set({ pending });

  add(u: number, v: number, depth: number): void {
    const { draft, scene } = this.store.state;
    if (!scene || !(depth > 0)) return;
    const points = [...draft.points, { ...clamped(scene, u, v), depth, placed: true }];
    this.edit({ ...draft, points, count: draft.count === null ? null : draft.count + 1 });
    this.store.set({ selected: points.length - 1 });
  }

  change(index: number, change: Partial<Point>, gesture: string): void {
    const { draft, scene } = this.store.state;
    const old = draft.points[index];
    if (!old || !scene) return;
    const point = { ...old, ...change, placed: true };
    this.edit({ ...draft, points: draft.points.with(index, { ...point, ...clamped(scene, point.u, point.v) }) }, gesture);
  }

  remove(index: number): void {
    const { draft } = this.store.state;
    if (!draft.points[index]) return;
    this.store.set({ selected: null });
    this.edit({ ...draft, points: draft.points.toSpliced(index, 1) });
  }

  clear(): void {
    this.store.set({ selected: null });
    this.edit({ ...this.store.state.draft, points: [], count: null });
  }

  setFit(change: Partial<Fit>, gesture: string | null = null): void {
    const { draft } = this.store.state;
    this.edit({ ...draft, fit: { ...draft.fit, ...change } }, gesture);
  }

  setCount(count: number): void {
    const { draft } = this.store.state;
    this.edit({ ...draft, count: count >= draft.points.length ? null : count }, "count");
  }

  seal = (): void => this.history.seal();

  undo = (): void => {
    this.history.undo();
    this.apply();
  };

  redo = (): void => {
    this.history.redo();
    this.apply();
  };

  private restart(draft: Draft): void {
    this.history = new History(draft);
    this.apply();
  }

  private apply(): void {
    const draft = this.history.current;
    const before = this.store.state;
    const used = draft.points === before.draft.points && draft.count === before.draft.count ? before.used : subset(draft.points, draft.count);
    const selected = before.selected !== null && before.selected < draft.points.length ? before.selected : null;
    this.store.set({ draft, used, selected, canUndo: this.history.canUndo, canRedo: this.history.canRedo });
    this.address();
    if (draft !== before.draft) this.fitter.request();
  }

  // View

  look(change: Partial<View>): void {
    const before = this.store.state.view;
    this.store.set({ view: { ...before, ...change } });
    const needs = (view: View) => view.layer === "deviation" || view.cloud === "deviation" || view.cut !== null;
    if (!needs(before) && needs(this.store.state.view) && !this.store.state.answer?.deviation) this.fitter.request();
    this.address();
  }

  select = (selected: number | null): void => this.store.set({ selected });
  point = (cursor: { u: number; v: number } | null): void => this.store.set({ cursor });

  depthAt(u: number, v: number): number | null {
    const { answer } = this.store.state;
    return answer ? sampled(answer.layers.depth, answer.layers.width, answer.layers.height, u, v) : null;
  }

  /** The camera of the scene, or one with the assumed field of view. */
  camera(): Intrinsics {
    const { scene, view } = this.store.state;
    if (!scene) return { fx: 1, fy: 1, cx: 0, cy: 0 };
    return scene.camera ?? assumed(scene, view.field);
  }

  // Downloads

  async download(format: Format): Promise<{ name: string; contents: Blob } | null> {
    const { scene, draft, used, view } = this.store.state;
    if (!scene || draft.points.length === 0) return null;
    let contents: Blob | null = null;
    await this.guarded("preparing the file", async () => {
      const points = draft.points.filter((_, i) => used[i]);
      const own = format === "ply" && !scene.camera;
      const cloud = { max_sigma: view.cut, ...(view.unmeasured && { max_relative_sigma: NO_LIMIT }), ...(view.flying && { keep_flying: true }) };
      const options = format === "ply" ? { ...draft.fit, ...cloud } : draft.fit;
      contents = own
        ? await this.service.cloud(scene, points, options, this.camera())
        : await this.service.download(scene.id, points, options, format);
    });
    const stem = scene.name.replace(/\.[^.]*$/, "");
    return contents ? { name: stem + FORMATS[format].suffix, contents } : null;
  }

  /** The address of the page with all settings. */
  link(): string {
    const { scene, draft, view } = this.store.state;
    const points = scene && draft.points === scene.given && !("file" in scene.source) ? null : draft.points;
    const { fit, count } = draft;
    const fragment = link.written({ source: scene?.source ?? null, fit, count, view, points });
    return `${location.origin}${location.pathname}#${fragment}`;
  }

  /** Keeps the settings of a link until its image is open. `instead` is an action that opens another image. */
  expect(linked: link.Linked, instead: Notice["action"] | null = null): void {
    this.linked = linked;
    this.store.set({ view: { ...this.store.state.view, theme: linked.view.theme } });
    if (linked.source && "file" in linked.source) {
      const { file, width, height } = linked.source;
      this.note(`this address is about ${file} (${width}×${height})`, "open that image to go on; the address has its points and settings, but no image", instead);
    }
  }

  /** Updates the address of the page 400 ms after the last change. */
  private address(): void {
    clearTimeout(this.addressTimer);
    this.addressTimer = window.setTimeout(() => {
      if (this.store.state.scene) window.history.replaceState(null, "", this.link());
    }, 400);
  }

  // Notices

  note(message: string, hint: string | null = null, action: Notice["action"] | null = null): void {
    this.store.set({ notice: { kind: "note", message, hint, ...(action && { action }) } });
  }

  dismiss = (): void => this.store.set({ notice: null });

  private async guarded(waiting: string, work: () => Promise<void>): Promise<void> {
    const before = this.store.state.waiting;
    this.store.set({ waiting });
    try {
      await work();
    } catch (error) {
      this.fail(error);
    } finally {
      this.store.set({ waiting: before });
    }
  }

  fail(error: unknown): void {
    if (error instanceof ServiceError) {
      const { message, hint, status } = error;
      const again = status === 0 || status === 429 || status === 503;
      const action = { label: "Try again", run: () => (this.dismiss(), this.fitter.request()) };
      this.store.set({ notice: { kind: "error", message, hint, ...(again && this.store.state.scene && { action }) } });
    } else {
      this.store.set({ notice: { kind: "error", message: String(error instanceof Error ? error.message : error), hint: null } });
    }
  }
}

const clamped = (scene: Scene, u: number, v: number) => ({
  u: Math.min(scene.width - 1, Math.max(0, u)),
  v: Math.min(scene.height - 1, Math.max(0, v)),
});
