// The value at the cursor with its error bar.

import { h } from "../dom.ts";
import { metres, withSign } from "../model/numbers.ts";
import type { State } from "../state.ts";

export class Readout {
  private readonly place = h("span", { class: "place" });
  private readonly value = h("span", { class: "value" });
  private readonly more = h("span", { class: "more" });
  readonly element = h("div", { class: "readout" }, this.place, this.value, this.more);
  private drawn: unknown[] = [];

  show({ scene, answer, cursor, selected, draft, used }: State): void {
    const wanted = [scene, answer, cursor, selected, used];
    if (wanted.every((part, i) => part === this.drawn[i])) return;
    this.drawn = wanted;
    const point = selected === null ? undefined : draft.points[selected];
    const place = cursor ?? (point && { u: Math.round(point.u), v: Math.round(point.v) });
    if (!scene || !place) {
      this.place.textContent = draft.points.length === 0 ? "Click into the image where you know a depth" : "Point at the image";
      this.value.textContent = this.more.textContent = "";
      return;
    }
    this.place.textContent = `u ${place.u}  v ${place.v}`;
    if (!answer) return void (this.value.textContent = this.more.textContent = "");
    const at = place.v * answer.layers.width + place.u;
    const deviation = answer.deviation?.[at];
    this.value.replaceChildren(
      metres(answer.layers.depth[at]),
      deviation === undefined ? "" : h("span", { class: answer.stale ? "bar stale" : "bar", title: "One standard deviation: 68.3 % of errors are expected to be smaller" }, ` ± ${metres(deviation)}`),
    );
    const fitted = selected === null ? null : answer.fitted[selected];
    this.more.textContent = fitted
      ? `residual ${withSign(fitted.residual)}  leave-one-out ${withSign(fitted.leaveOneOut)}`
      : selected !== null && used[selected] === false ? "a point that is not used" : "";
  }
}
