// The frames of one or two runs as a gallery.

import type { App } from "../app.ts";
import { h, segments, select } from "../dom.ts";
import { count, metres } from "../model/numbers.ts";
import type { Frame, Run } from "../service.ts";
import { Wipe } from "./wipe.ts";

const ORDERS = [["name", "name"], ["error", "largest error"], ["deviation", "largest standard deviation"], ["failure", "failures first"], ["change", "largest difference between runs"]] as const;
type Order = (typeof ORDERS)[number][0];

export interface Pair {
  readonly id: string;
  readonly a: Frame | null;
  readonly b: Frame | null;
}

/** Pairs the frames of two runs by id. */
export function paired(a: Run, b: Run | null): Pair[] {
  const others = new Map(b?.frames.map((frame) => [frame.id, frame]));
  const pairs: Pair[] = a.frames.map((frame) => ({ id: frame.id, a: frame, b: others.get(frame.id) ?? null }));
  const known = new Set(a.frames.map((frame) => frame.id));
  return [...pairs, ...(b?.frames ?? []).filter((frame) => !known.has(frame.id)).map((frame) => ({ id: frame.id, a: null, b: frame }))];
}

export function ordered(pairs: readonly Pair[], order: Order): Pair[] {
  const most = (pair: Pair, value: (frame: Frame) => number | null | undefined) =>
    Math.max(...[pair.a, pair.b].map((frame) => (frame ? (value(frame) ?? -1) : -1)));
  const key = (pair: Pair): number => {
    switch (order) {
      case "name": return 0;
      case "error": return -most(pair, (frame) => frame.error);
      case "deviation": return -most(pair, (frame) => frame.standard_deviation);
      case "failure": return -most(pair, (frame) => (frame.failure ? 1 : 0));
      case "change": return -Math.abs((pair.a?.error ?? 0) - (pair.b?.error ?? 0));
    }
  };
  return [...pairs].sort((x, y) => key(x) - key(y) || x.id.localeCompare(y.id, "en", { numeric: true }));
}

/** Error and standard deviation of a frame, as far as they are known. */
export function numbers(frame: Frame | null): (readonly [name: string, value: string])[] {
  if (!frame || frame.failure) return [];
  const known = [[frame.error_kind ?? "error", frame.error], ["σ", frame.standard_deviation]] as const;
  return known.flatMap(([name, value]) => (value == null ? [] : [[name, metres(value)] as const]));
}

export class Gallery {
  readonly element: HTMLElement;
  private readonly grid = h("div", { class: "grid" });
  private readonly summary = h("p", { class: "where" });
  private readonly wipe: Wipe;
  private order: Order = "name";
  private failures = false;
  private a: Run;
  private b: Run | null = null;

  constructor(
    app: App,
    runs: readonly Run[],
    opened: () => void,
  ) {
    this.a = runs[0] ?? { name: "", frames: [] };
    this.b = runs[1] ?? null;
    this.wipe = new Wipe(app.service, (frame) => {
      if (!frame.image) return;
      opened();
      void app.openAddresses(frame.image, frame.points ?? null, null, frame.id.split("/").pop());
    });
    const names = runs.map((run, i) => [String(i), run.name] as const);
    const first = select("Run", names, (i) => this.choose(() => (this.a = runs[Number(i)]!)));
    const second = select("Compare with", [["", "nothing"] as const, ...names], (i) => this.choose(() => (this.b = i === "" ? null : runs[Number(i)]!)));
    second.set(this.b ? "1" : "");
    const order = select("Sort by", ORDERS, (name) => this.choose(() => (this.order = name)));
    const only = segments("Frames", [["all", "All"], ["failures", "Failures"]], (which) => this.choose(() => (this.failures = which === "failures")));
    only.set("all");
    this.element = h("section", { class: "gallery", "aria-label": "Gallery" },
      h("h1", { class: "hidden" }, "Results"),
      h("header", {}, first.element, runs.length > 1 ? second.element : null, order.element, only.element, this.summary),
      this.grid, this.wipe.element);
    this.fill();
  }

  private choose(change: () => void): void {
    change();
    this.fill();
  }

  private fill(): void {
    const all = ordered(paired(this.a, this.b === this.a ? null : this.b), this.order);
    const failed = all.filter(({ a, b }) => a?.failure || b?.failure);
    const shown = this.failures ? failed : all;
    this.summary.textContent = `${count(all.length)} frames, ${failed.length === 0 ? "no failures" : `${count(failed.length)} failed`}`;
    this.grid.replaceChildren(...shown.map((pair, i) => this.card(pair, () => this.wipe.open(shown, i, [this.a.name, this.b?.name ?? null]))));
    if (shown.length === 0) this.grid.append(h("p", { class: "why" }, this.failures ? "No frame failed." : "There are no frames in this folder."));
  }

  private card({ id, a, b }: Pair, open: () => void): HTMLElement {
    const pictures = [a, b].filter((frame): frame is Frame => frame !== null).map((frame) =>
      frame.failure
        ? h("span", { class: "failed" }, frame.failure)
        : h("img", { src: frame.thumbnail ?? frame.image ?? "", alt: "", loading: "lazy", decoding: "async" }));
    const figures = [a, b].map((frame) => h("span", {}, ...numbers(frame).map(([name, value]) => h("span", {}, `${name} `, h("strong", {}, value)))));
    const words = [a, b].flatMap((frame) => (frame ? [frame.failure ? "failed" : numbers(frame).map((pair) => pair.join(" ")).join(", ")] : []));
    return h("button", { type: "button", class: "card", onclick: open, "aria-label": `${id}: ${words.join(" and ")}` },
      h("span", { class: pictures.length > 1 ? "pictures two" : "pictures" }, ...pictures),
      h("span", { class: "id" }, id), h("span", { class: "figures", title: "The error, and σ, the median of the standard deviations of all pixels" }, ...figures));
  }
}
