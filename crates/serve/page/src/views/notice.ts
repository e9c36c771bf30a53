// Notices: errors with hints, notes, and the operation in progress.

import type { App } from "../app.ts";
import { h, iconButton } from "../dom.ts";
import type { Notice, State } from "../state.ts";

/** Milliseconds until a note without an action closes; errors stay. */
const STAY = 7000;

export class Notices {
  private readonly text = h("p", {});
  private readonly hint = h("p", { class: "hint" });
  private readonly action = h("button", { type: "button" });
  private readonly box: HTMLElement;
  private readonly waiting = h("div", { class: "waiting", role: "status" });
  readonly element: HTMLElement;
  private shown: Notice | null = null;
  private timer = 0;

  constructor(private readonly app: App) {
    this.box = h("div", { class: "notice", hidden: true },
      h("div", {}, this.text, this.hint), this.action, iconButton("close", "Close", app.dismiss));
    // Screen readers announce changes of regions that exist beforehand.
    this.element = h("div", { class: "notices" }, h("div", { role: "alert" }, this.box), this.waiting);
  }

  show({ notice, waiting }: State): void {
    this.waiting.textContent = waiting ? sentence(waiting) + "…" : "";
    this.waiting.classList.toggle("active", waiting !== null);
    if (notice === this.shown) return;
    this.shown = notice;
    clearTimeout(this.timer);
    this.box.hidden = !notice;
    if (!notice) return;
    this.box.classList.toggle("error", notice.kind === "error");
    this.text.textContent = sentence(notice.message);
    this.hint.textContent = notice.hint ? sentence(notice.hint) : "";
    this.action.hidden = !notice.action;
    this.action.textContent = notice.action?.label ?? "";
    this.action.onclick = notice.action?.run ?? null;
    if (notice.kind === "note" && !notice.action) this.timer = window.setTimeout(this.app.dismiss, STAY);
  }
}

/** Capitalises a text, unless it begins with a file name. */
const sentence = (text: string): string => (/^[a-z]+ /.test(text) ? text.charAt(0).toUpperCase() + text.slice(1) : text);
