// What the fit says of itself.

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
    why: "Of the middle pixel: 68.3 % of its errors are expected to be smaller",
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
  private drawn: unknown = undefined;
  readonly element = h("section", { class: "group numbers", "aria-label": "Result" },
    h("dl", {}, ...FIGURES.map(({ name, why }, i) => h("div", { title: why }, h("dt", {}, name), this.values[i]!))),
    this.time);

  show(state: State): void {
    if (state.answer === this.drawn) return;
    this.drawn = state.answer;
    FIGURES.forEach((figure, i) => (this.values[i]!.textContent = figure.value(state)));
    this.values.forEach((value, i) => {
      const stale = (i === 1 || i === 4) && state.answer?.stale;
      value.classList.toggle("stale", Boolean(stale));
    });
    // Outliers of an earlier fit are better than none while a point is dragged.
    const { answer } = state;
    const seconds = answer?.layers.report.seconds;
    this.time.textContent = answer
      ? `${seconds?.fit === undefined ? "" : `fit ${milliseconds(seconds.fit)} · `}answer ${milliseconds(answer.seconds)}`
      : "No points yet";
  }
}
