// The form beside a point that edits its depth, with the map following, or asks for the depth of a new point.

import type { App } from "../app.ts";
import { h, iconButton, slider } from "../dom.ts";
import { plain } from "../model/numbers.ts";
import type { Pixel, State } from "../state.ts";
import type { Frame } from "./frame.ts";

const STEPS = 400;

export class Editor {
  readonly element: HTMLFormElement;
  /** Index of the edited point; null for a new one. */
  private index: number | null = null;
  private middle = 1;
  private gesture = "";
  private readonly title = h("span", { class: "title" });
  private readonly input = h("input", {
    type: "number", min: "0", step: "any", inputMode: "decimal", autocomplete: "off",
    "aria-label": "Depth in metres", oninput: () => this.typed(),
  });
  private readonly accept = h("button", { class: "main", title: "Enter" }, "Set");
  private readonly pull = slider({
    label: "Pull nearer or farther", hidden: true, steps: STEPS,
    text: (step) => `${plain(this.depthOf(step))} m`,
    change: (step) => {
      this.input.value = String(Number(this.depthOf(step).toPrecision(5)));
      this.typed();
    },
  });
  private readonly bin = iconButton("bin", "Remove the point", () => this.remove());

  constructor(
    private readonly app: App,
    private readonly back: () => void,
  ) {
    this.element = h("form", {
      class: "editor", hidden: true, noValidate: true, "aria-label": "Depth of a point",
      onsubmit: (event: Event) => {
        event.preventDefault();
        this.submit();
      },
      onkeydown: (event: KeyboardEvent) => this.key(event),
    },
      h("div", { class: "line" }, this.title, this.bin, iconButton("close", "Close", () => this.finish())),
      h("label", { class: "depth" }, this.input, h("span", { class: "unit" }, "m"), this.accept),
      this.pull.element,
    );
    document.addEventListener("pointerdown", (event) => {
      if (this.app.store.state.pending && !this.element.contains(event.target as Node)) this.close();
    });
  }

  open(index: number): void {
    const point = this.app.store.state.draft.points[index];
    if (!point) return;
    this.input.value = String(Number(point.depth.toPrecision(4)));
    this.input.placeholder = "";
    this.begin(index, point.depth);
    this.input.select();
  }

  /** Asks for the depth of a new point, which is added once its depth is accepted. */
  ask(place: Pixel): void {
    const depth = this.app.depthAt(place.u, place.v);
    this.app.propose(place);
    this.input.value = "";
    this.input.placeholder = depth === null ? "depth" : `map: ${plain(depth)}`;
    this.begin(null, depth);
  }

  /** Shows the form. `middle` is the depth at the centre of the slider; null hides the slider. */
  private begin(index: number | null, middle: number | null): void {
    this.index = index;
    this.middle = middle ?? 1;
    this.gesture = `depth ${Math.random()}`;
    this.pull.element.hidden = middle === null;
    this.pull.set(STEPS / 2);
    this.accept.hidden = index !== null;
    this.bin.hidden = index === null;
    this.element.hidden = false;
    this.show(this.app.store.state, null);
    this.input.focus({ preventScroll: true });
  }

  close(): void {
    if (this.element.hidden) return;
    this.element.hidden = true;
    this.app.propose(null);
    this.app.seal();
  }

  show(state: State, frame: Frame | null): void {
    if (this.element.hidden || !state.scene) return;
    const point = this.index === null ? state.pending : state.draft.points[this.index];
    if (!point || (this.index !== null && state.selected !== this.index)) return this.close();
    this.title.textContent = `${this.index === null ? "New point" : `Point ${this.index + 1}`} · u ${Math.round(point.u)} v ${Math.round(point.v)}`;
    if (!frame) return;
    const { clientWidth: width, clientHeight: height } = this.element.parentElement!;
    const [x, y] = [frame.x(point.u), frame.y(point.v)];
    const [w, h] = [this.element.offsetWidth, this.element.offsetHeight];
    const left = x + 18 + w < width ? x + 18 : x - 18 - w;
    this.element.style.left = `${Math.min(Math.max(4, left), Math.max(4, width - w - 4))}px`;
    this.element.style.top = `${Math.min(Math.max(4, y - h / 2), Math.max(4, height - h - 4))}px`;
  }

  private depthOf = (step: number): number => this.middle * 2 ** ((2 * step) / STEPS - 1);

  /** The typed depth; null if it is not positive. */
  private depth(): number | null {
    const depth = this.input.valueAsNumber;
    return depth > 0 && Number.isFinite(depth) ? depth : null;
  }

  /** Updates an existing point while its depth is typed; a new one waits for acceptance. */
  private typed(): void {
    const depth = this.depth();
    if (this.index !== null && depth !== null) this.app.change(this.index, { depth }, this.gesture);
  }

  /** Adds a new point if it has a depth, and closes the form. */
  private submit(): void {
    const [{ pending }, depth] = [this.app.store.state, this.depth()];
    if (this.index === null && pending && depth !== null) this.app.add(pending.u, pending.v, depth);
    this.finish();
  }

  private finish(): void {
    this.close();
    this.back();
  }

  private remove(): void {
    if (this.index !== null) this.app.remove(this.index);
    this.finish();
  }

  private key(event: KeyboardEvent): void {
    if (event.key === "Escape") {
      event.preventDefault();
      this.finish();
    } else if (event.key === "Delete" && event.target !== this.input) {
      event.preventDefault();
      this.remove();
    }
    event.stopPropagation();
  }
}
