// Shows that a slow map is being computed; an earlier map is drawn pale meanwhile.

import { h } from "../dom.ts";
import type { Answer, State } from "../state.ts";

/** Milliseconds without an answer before the message appears; maps come faster while a point is dragged. */
const PATIENCE = 400;

export class Busy {
  readonly element = h("p", { class: "busy", role: "status", hidden: true });
  private shown: string | null = null;
  private answer: Answer | null = null;
  private timer = 0;

  show({ scene, fitting, answer, draft }: State): void {
    const current = answer?.draft === draft;
    const what = !scene || !fitting ? null : current ? "Computing standard deviations…" : "Computing the map…";
    if (what === this.shown && answer === this.answer) return;
    [this.shown, this.answer] = [what, answer];
    clearTimeout(this.timer);
    this.set(null, false);
    if (what) this.timer = window.setTimeout(() => this.set(what, !current), PATIENCE);
  }

  private set(what: string | null, old: boolean): void {
    this.element.hidden = what === null;
    this.element.textContent = what ?? "";
    document.body.dataset.old = String(old);
  }
}
