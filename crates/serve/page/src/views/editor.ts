// The small form beside a point: its depth, which the map follows while it is typed or pulled.

import type { App } from "../app.ts";
import { h, iconButton, slider } from "../dom.ts";
import { plain } from "../model/numbers.ts";
import type { Pixel, State } from "../state.ts";
import type { Frame } from "./frame.ts";

const STEPS = 400;

export class Editor {
  readonly element: HTMLFormElement;
  private index: number | null = null;
  private place: Pixel | null = null;
  private fresh = false;
  private middle = 1;
  private gesture = "";
  private readonly title = h("span", { class: "title" });
  private readonly input = h("input", {
    type: "number", min: "0", step: "any", inputMode: "decimal", required: true, autocomplete: "off",
    "aria-label": "Depth in metres", oninput: () => this.typed(),
  });
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
      class: "editor", hidden: true, "aria-label": "Depth of a point",
      onsubmit: (event: Event) => {
        event.preventDefault();
        this.finish();
      },
      onkeydown: (event: KeyboardEvent) => this.key(event),
    },
      h("div", { class: "line" }, this.title, this.bin, iconButton("close", "Close", () => this.finish())),
      h("label", { class: "depth" }, this.input, h("span", { class: "unit" }, "m")),
      this.pull.element,
    );
  }

  /** Edits a point; one that is fresh is removed again by Escape. */
  open(index: number, fresh: boolean): void {
    const point = this.app.store.state.draft.points[index];
    if (!point) return;
    this.begin(index, point, fresh);
    this.middle = point.depth;
    this.input.value = String(Number(point.depth.toPrecision(4)));
    this.pull.set(STEPS / 2);
    this.pull.element.hidden = false;
    this.input.select();
  }

  /** Asks for the depth of a point where there is no map yet. */
  ask(u: number, v: number): void {
    this.begin(null, { u, v }, true);
    this.input.value = "";
    this.input.placeholder = "depth";
    this.pull.element.hidden = true;
  }

  private begin(index: number | null, place: Pixel, fresh: boolean): void {
    this.index = index;
    this.place = place;
    this.fresh = fresh;
    this.gesture = `depth ${Math.random()}`;
    this.element.hidden = false;
    this.show(this.app.store.state, null);
    this.input.focus({ preventScroll: true });
  }

  close(): void {
    if (this.element.hidden) return;
    this.element.hidden = true;
    this.app.seal();
  }

  show(state: State, frame: Frame | null): void {
    if (this.element.hidden || !state.scene) return;
    const point = this.index === null ? this.place : state.draft.points[this.index];
    if (!point || (this.index !== null && state.selected !== this.index)) return this.close();
    this.title.textContent = `${this.index === null ? "New point" : `Point ${this.index + 1}`} · u ${Math.round(point.u)} v ${Math.round(point.v)}`;
    this.bin.hidden = this.index === null;
    if (!frame) return;
    const { clientWidth: width, clientHeight: height } = this.element.parentElement!;
    const [x, y] = [frame.x(point.u), frame.y(point.v)];
    const [w, h] = [this.element.offsetWidth, this.element.offsetHeight];
    const left = x + 18 + w < width ? x + 18 : x - 18 - w;
    this.element.style.left = `${Math.min(Math.max(4, left), Math.max(4, width - w - 4))}px`;
    this.element.style.top = `${Math.min(Math.max(4, y - h / 2), Math.max(4, height - h - 4))}px`;
  }

  private depthOf = (step: number): number => this.middle * 2 ** ((2 * step) / STEPS - 1);

  private typed(): void {
    const depth = this.input.valueAsNumber;
    if (!(depth > 0) || !Number.isFinite(depth)) return;
    if (this.index !== null) return this.app.change(this.index, { depth }, this.gesture);
    const { u, v } = this.place!;
    this.index = this.app.add(u, v, depth);
    this.middle = depth;
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
      if (this.fresh) this.remove();
      else this.finish();
    } else if (event.key === "Delete" && event.target !== this.input) {
      event.preventDefault();
      this.remove();
    }
    event.stopPropagation();
  }
}
