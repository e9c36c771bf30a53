// Settings of points, fit and colours.

import type { App } from "../app.ts";
import { ACCEPT_CAMERA, ACCEPT_IMAGE, ACCEPT_POINTS } from "../files.ts";
import { h, select, slider } from "../dom.ts";
import { MAPS, type MapName } from "../model/colours.ts";
import { count } from "../model/numbers.ts";
import { csv } from "../model/points.ts";
import { FITS, MARKS, PRIORS, ROBUST, type Fit, type View } from "../model/settings.ts";
import { save } from "../dom.ts";
import type { State } from "../state.ts";
import { command } from "./downloads.ts";

const STEPS = 200;

const ROBUST_NAMES: Record<(typeof ROBUST)[number], string> = {
  none: "none", auto: "auto (mixture)", huber: "Huber", cauchy: "Cauchy", gm: "Geman–McClure", tukey: "Tukey", irls: "IRLS (paper)",
};
const FIT_NAMES: Record<(typeof FITS)[number], string> = {
  joint: "joint: both", lse: "lse: basis functions", field: "field: smooth",
};
const PRIOR_NAMES: Record<(typeof PRIORS)[number], string> = { learned: "learned", flat: "flat", none: "none" };
const MARK_NAMES: Record<(typeof MARKS)[number], string> = {
  residual: "residual", "leave-one-out": "leave-one-out error", deviation: "standard deviation", outlier: "outliers", depth: "depth", none: "hidden",
};
const MAP_NAMES: Record<MapName, string> = {
  viridis: "viridis (uniform)", magma: "magma (uniform)", turbo: "turbo (as files)", grey: "grey (uniform)",
};

const named = <T extends string>(values: readonly T[], names: Record<T, string>) => values.map((value) => [value, names[value]] as const);
const stored = <T extends string>(values: readonly T[], names: Record<T, string>) =>
  [["", "default"] as const, ...named(values, names)];

export class Panel {
  readonly element: HTMLElement;
  private readonly thin;
  private readonly controls;
  private readonly sigma;
  private readonly field;
  private readonly low;
  private readonly high;
  private readonly fieldRow;
  private readonly clear;
  private readonly table;
  private total = 1;
  private drawn: unknown[] = [];

  constructor(private readonly app: App) {
    const fit = (change: Partial<Fit>) => app.setFit(change);
    const look = (change: Partial<View>) => app.look(change);
    this.thin = slider({
      label: "Points used", steps: STEPS,
      text: (step) => (this.total === 0 ? "none" : `${count(this.countOf(step))} of ${count(this.total)}`),
      change: (step) => app.setCount(this.countOf(step)),
      done: app.seal,
    });
    this.controls = {
      robust: select("Robust", stored(ROBUST, ROBUST_NAMES), (robust) => fit({ robust: robust === "" ? null : robust })),
      fit: select("Fit", stored(FITS, FIT_NAMES), (name) => fit({ fit: name === "" ? null : name })),
      prior: select("Prior", stored(PRIORS, PRIOR_NAMES), (prior) => fit({ prior: prior === "" ? null : prior })),
      marks: select("Colour by", named(MARKS, MARK_NAMES), (marks) => look({ marks })),
      colours: select("Depth", named(MAPS, MAP_NAMES), (colours) => look({ colours })),
      marksOpacity: slider({
        label: "Opacity", steps: 100, text: (step) => `${step} %`, change: (step) => look({ marksOpacity: step / 100 }),
      }),
    };
    this.sigma = number("Point deviation", "m", "as estimated", (sigma) => app.setFit({ sigma }, "sigma"), app.seal);
    this.low = number("Nearest", "m", "auto", (low) => look({ low }));
    this.high = number("Farthest", "m", "auto", (high) => look({ high }));
    this.field = slider({
      label: "Assumed field of view", steps: 120, text: (step) => `${20 + step}°`, change: (step) => look({ field: 20 + step }),
    });
    this.fieldRow = h("div", {}, this.field.element);
    this.clear = h("button", { type: "button", onclick: () => app.clear() }, "Remove all");
    this.table = h("button", { type: "button", onclick: () => this.saveTable() }, "Save CSV");
    this.element = h("div", { class: "settings" },
      h("section", { class: "group", "aria-label": "Points" }, h("h2", {}, "Points"),
        this.thin.element, this.controls.marks.element, this.controls.marksOpacity.element,
        h("div", { class: "buttons" }, chooser("Open…", ACCEPT_POINTS, "Open points", app), this.table, this.clear)),
      h("section", { class: "group", "aria-label": "Fit" }, h("h2", {}, "Fit"),
        this.controls.robust.element, this.controls.fit.element, this.controls.prior.element, this.sigma.element),
      h("section", { class: "group", "aria-label": "Colours and camera" }, h("h2", {}, "Colours and camera"),
        this.controls.colours.element, h("div", { class: "pair" }, this.low.element, this.high.element),
        this.fieldRow, app.service.cameras ? h("div", { class: "buttons" }, chooser("Camera…", ACCEPT_CAMERA, "Open a camera file", app)) : null),
    );
  }

  show(state: State): void {
    const { draft, view, scene } = state;
    const wanted = [draft, view, scene];
    if (wanted.every((part, i) => part === this.drawn[i])) return;
    this.drawn = wanted;
    this.total = draft.points.length;
    this.thin.set(this.stepOf(draft.count ?? this.total));
    this.controls.robust.set(draft.fit.robust ?? "");
    this.controls.fit.set(draft.fit.fit ?? "");
    this.controls.prior.set(draft.fit.prior ?? "");
    this.controls.marks.set(view.marks);
    this.controls.colours.set(view.colours);
    this.controls.marksOpacity.set(Math.round(100 * view.marksOpacity));
    this.sigma.set(draft.fit.sigma);
    this.low.set(view.low);
    this.high.set(view.high);
    this.field.set(Math.round(view.field) - 20);
    this.fieldRow.hidden = Boolean(scene?.camera);
    this.clear.disabled = this.table.disabled = this.total === 0;
  }

  /** The number of points of a step; steps are even in its logarithm. */
  private countOf(step: number): number {
    return step >= STEPS ? this.total : Math.max(1, Math.round(this.total ** (step / STEPS)));
  }

  private stepOf(points: number): number {
    return points >= this.total ? STEPS : Math.round((STEPS * Math.log(points)) / Math.log(this.total));
  }

  private saveTable(): void {
    const { draft, used, scene } = this.app.store.state;
    const { sigma } = draft.fit;
    const points = draft.points.filter((_, i) => used[i]).map((point) => (sigma === null ? point : { sigma, ...point }));
    if (scene) save(command(this.app.store.state).points, new Blob([csv(points)], { type: "text/csv" }));
  }
}

/** A button that chooses files and opens them. */
export function chooser(text: string, accept: string, label: string, app: App, main = false): HTMLElement {
  const input = h("input", {
    type: "file", multiple: true, accept, "aria-label": label, class: "hidden",
    onchange: () => {
      void app.openFiles([...(input.files ?? [])]);
      input.value = "";
    },
  });
  return h("label", { class: main ? "button main" : "button" }, input, text);
}

export const chooseImage = (app: App, text: string, main = false): HTMLElement =>
  chooser(text, [ACCEPT_IMAGE, ACCEPT_POINTS, ACCEPT_CAMERA].join(","), "Open an image, and its points", app, main);

/** An optional number. */
function number(label: string, unit: string, placeholder: string, change: (value: number | null) => void, done?: () => void) {
  const input = h("input", {
    type: "number", min: "0", step: "any", inputMode: "decimal", placeholder,
    oninput: () => {
      const value = input.valueAsNumber;
      if (input.value === "") change(null);
      else if (value > 0) change(value);
    },
    onchange: () => done?.(),
  });
  return {
    element: h("label", { class: "field" }, h("span", {}, label), h("span", { class: "number" }, input, h("span", { class: "unit" }, unit))),
    set: (value: number | null) => {
      if (document.activeElement !== input) input.value = value === null ? "" : String(value);
    },
  };
}
