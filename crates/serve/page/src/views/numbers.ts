// Statistics of the fit.

import { h } from "../dom.ts";
import { count, metres, milliseconds } from "../model/numbers.ts";
import type { State } from "../state.ts";

interface Figure {
  readonly name: string;
  readonly why: string;
  readonly value: (state: State) => string;
}

const FIGURES: readonly Figure[] = [
  {
    name: "Leave-one-out error",
    why: "Root mean square of the errors at each point when it is predicted from the others: the error to expect between the points",
    value: ({ answer }) => metres(answer?.layers.report.fit?.leave_one_out),
  },
  {
    name: "Standard deviation",
    why: "The median of all pixels: half of them are surer than this, and 68.3 % of errors are expected to be smaller than one standard deviation",
    value: ({ answer }) => metres(answer?.middleDeviation),
  },
  {
    name: "Residual",
    why: "Root mean square of the differences between map and points",
    value: ({ answer }) => metres(answer?.layers.report.fit?.residual),
  },
  {
    name: "Error at unused points",
    why: "Root mean square of the errors at the points that the slider leaves out: a true test of the map",
    value: ({ answer }) => metres(answer?.heldOut),
  },
  {
    name: "Outliers",
    why: "Points that are more likely wrong than right, judged by the others",
    value: ({ answer }) => {
      const marks = answer?.layers.points.map((point) => point.outlier) ?? [];
      return marks.length === 0 || marks.every((mark) => mark === null) ? "–" : count(marks.filter((mark) => (mark ?? 0) > 0.5).length);
    },
  },
  {
    name: "Depth",
    why: "From the nearest pixel to the farthest",
    value: ({ answer }) => (answer ? `${answer.low.toFixed(2)}–${answer.high.toFixed(2)} m` : "–"),
  },
];

export class Numbers {
  private readonly values = FIGURES.map(() => h("dd", {}));
  private readonly time = h("p", { class: "time" });
  private drawn: unknown[] = [];
  private readonly remarks = h("ul", { class: "remarks", "aria-label": "To be checked", hidden: true });
  readonly element = h("section", { class: "group numbers", "aria-label": "Result" },
    h("dl", {}, ...FIGURES.map(({ name, why }, i) => h("div", { title: why }, h("dt", {}, name), this.values[i]!))),
    this.time, this.remarks);

  show(state: State): void {
    const wanted = [state.answer, state.scene];
    if (wanted.every((part, i) => part === this.drawn[i])) return;
    this.drawn = wanted;
    const remarks = new Set([...(state.scene?.remarks ?? []), ...(state.answer?.layers.report.remarks ?? [])]);
    this.remarks.hidden = remarks.size === 0;
    this.remarks.replaceChildren(...[...remarks].map((remark) => h("li", {}, remark)));
    FIGURES.forEach((figure, i) => (this.values[i]!.textContent = figure.value(state)));
    this.values.forEach((value, i) => {
      const stale = (i === 1 || i === 4) && state.answer?.stale;
      value.classList.toggle("stale", Boolean(stale));
    });
    const { answer } = state;
    const seconds = answer?.layers.report.seconds;
    this.time.textContent = answer
      ? `${seconds?.fit === undefined ? "" : `fit ${milliseconds(seconds.fit)} · `}answer ${milliseconds(answer.seconds)}`
      : "No points yet";
  }
}
