// The dialog of keyboard and mouse controls.

import { h, iconButton } from "../dom.ts";

const KEYS: readonly (readonly [string, readonly (readonly [string, string])[]])[] = [
  ["Image", [
    ["Click, Enter", "a new point, which counts once its depth is set; or edit a point"],
    ["Drag, Alt+arrows", "move a point"],
    ["Delete", "remove a point"],
    ["Arrows, Shift+arrows", "move the cursor by 1 or 10 pixels"],
    ["N, P", "next and previous point"],
    ["Wheel, pinch, + −", "magnify; drag to move"],
  ]],
  ["Cloud", [
    ["Drag, arrows", "turn"],
    ["Shift+drag, Shift+arrows", "move"],
    ["Wheel, pinch, + −", "magnify"],
    ["Drag of a point", "pull it along its ray"],
    ["0", "reset the view"],
  ]],
  ["Everywhere", [
    ["Ctrl+Z, Ctrl+Shift+Z", "undo, redo"],
    ["Escape", "close; give up a new point"],
    ["?", "this list"],
  ]],
];

export class Help {
  readonly element: HTMLDialogElement;

  constructor() {
    this.element = h("dialog", { class: "help", "aria-label": "Keys" },
      h("header", {}, h("h2", {}, "Mouse, touch and keys"), iconButton("close", "Close", () => this.element.close())),
      ...KEYS.map(([name, keys]) => h("section", {}, h("h3", {}, name),
        h("dl", {}, ...keys.map(([key, what]) => h("div", {}, h("dt", {}, key), h("dd", {}, what)))))));
  }

  open = (): void => {
    if (!this.element.open) this.element.showModal();
  };
}
