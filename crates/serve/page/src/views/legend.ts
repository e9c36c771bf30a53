// Colour bars with their units.

import { h, sized, inks } from "../dom.ts";
import { table, type Table } from "../model/colours.ts";
import { labels } from "../model/numbers.ts";
import type { State } from "../state.ts";
import { depthRange, scale } from "./marks.ts";

interface Bar {
  readonly colours: Table;
  readonly low: number;
  readonly high: number;
  readonly label: string;
}

class ColourBar {
  readonly element: HTMLElement;
  private readonly canvas = h("canvas", { role: "img" });
  private readonly name = h("span", {});
  private drawn = "";

  constructor() {
    this.element = h("div", { class: "bar" }, this.name, this.canvas);
  }

  show(bar: Bar | null, theme: string): void {
    this.element.hidden = !bar;
    if (!bar) return;
    const width = this.element.clientWidth;
    const wanted = [bar.low, bar.high, bar.label, bar.colours[400], width, theme].join();
    if (wanted === this.drawn || width === 0) return;
    this.drawn = wanted;
    this.name.textContent = bar.label;
    this.canvas.setAttribute("aria-label", `${bar.label}: colours from ${bar.low.toPrecision(3)} to ${bar.high.toPrecision(3)} metres`);
    const density = sized(this.canvas, width, 24);
    const context = this.canvas.getContext("2d")!;
    context.setTransform(density, 0, 0, density, 0, 0);
    context.clearRect(0, 0, width, 24);
    for (let x = 0; x < width; x += 1 / density) {
      const i = 4 * Math.min(255, Math.floor((256 * x) / width));
      context.fillStyle = `rgb(${bar.colours[i]} ${bar.colours[i + 1]} ${bar.colours[i + 2]})`;
      context.fillRect(x, 0, 1 / density + 0.01, 8);
    }
    const { quiet } = inks(this.element);
    context.fillStyle = quiet;
    context.font = "11px Inter, system-ui, sans-serif";
    context.textBaseline = "bottom";
    for (const { text, at, left } of labels(bar.low, bar.high, width, (text) => context.measureText(text).width)) {
      context.fillRect(Math.min(width - 1, Math.round(at)), 8, 1, 3);
      context.fillText(text, left, 24);
    }
  }
}

export class Legend {
  readonly element: HTMLElement;
  private readonly map = new ColourBar();
  private readonly marks = new ColourBar();

  constructor() {
    this.element = h("div", { class: "legend" }, this.map.element, this.marks.element);
    new ResizeObserver(() => this.last && this.show(this.last)).observe(this.element);
  }

  private last: State | null = null;

  show(state: State): void {
    this.last = state;
    const { answer, view } = state;
    this.map.show(answer && mapBar(state), view.theme);
    const marks = scale(view, answer);
    const same = view.marks === "depth" && view.layer === "depth";
    this.marks.show(marks && !same ? { ...marks, label: `points: ${marks.label}, m` } : null, view.theme);
  }
}

function mapBar({ answer, view }: State): Bar | null {
  if (!answer || view.layer === "none") return null;
  if (view.layer === "deviation") return { colours: table("magma"), low: 0, high: answer.highDeviation, label: "standard deviation, m" };
  const [low, high] = depthRange(view, answer);
  return { colours: table(view.colours), low, high, label: "depth, m" };
}
