// The points as a table, which also makes them accessible without sight.

import type { App } from "../app.ts";
import { h } from "../dom.ts";
import { count, plain, withSign } from "../model/numbers.ts";
import type { Fitted } from "../model/layers.ts";
import type { State } from "../state.ts";
import { isOutlier } from "./marks.ts";

/** Rows shown at first and added at each request; thousands at once would be slow. */
const ROWS = 200;

interface Column {
  readonly name: string;
  readonly title: string;
  readonly key: (index: number, fitted: Fitted | null, state: State) => number;
  readonly text: (index: number, fitted: Fitted | null, state: State) => string;
  readonly falling: boolean;
}

const COLUMNS: readonly Column[] = [
  { name: "#", title: "Number", falling: false, key: (i) => i, text: (i) => String(i + 1) },
  { name: "u", title: "Column, pixels", falling: false, key: (i, _, { draft }) => draft.points[i]!.u, text: (i, _, { draft }) => short(draft.points[i]!.u) },
  { name: "v", title: "Row, pixels", falling: false, key: (i, _, { draft }) => draft.points[i]!.v, text: (i, _, { draft }) => short(draft.points[i]!.v) },
  { name: "depth", title: "Depth, metres", falling: false, key: (i, _, { draft }) => draft.points[i]!.depth, text: (i, _, { draft }) => plain(draft.points[i]!.depth) },
  { name: "residual", title: "Point minus map, metres: positive where the point lies farther away", falling: true, key: (_, point) => Math.abs(point?.residual ?? -1), text: (_, point) => withSign(point?.residual ?? null) },
  { name: "leave-one-out", title: "Error when predicted from the other points, metres", falling: true, key: (_, point) => Math.abs(point?.leaveOneOut ?? -1), text: (_, point) => withSign(point?.leaveOneOut ?? null) },
  { name: "deviation", title: "Standard deviation of the map there, metres", falling: true, key: (_, point) => point?.deviation ?? -1, text: (_, point) => (point?.deviation === null || !point ? "–" : plain(point.deviation)) },
  { name: "wrong", title: "Probability that the point is wrong, if more than half", falling: true, key: (_, point) => point?.outlier ?? -1, text: (_, point) => (isOutlier(point) ? `${Math.round(100 * point!.outlier!)} %` : "") },
];

const short = (value: number): string => String(Math.round(10 * value) / 10);

export class List {
  readonly element: HTMLElement;
  private readonly body = h("tbody", {});
  private readonly headers: HTMLTableCellElement[];
  private readonly note = h("span", { class: "where" });
  private readonly area: HTMLDivElement;
  private readonly more = h("button", { type: "button", hidden: true, onclick: () => this.showMore() });
  private most = ROWS;
  private sort = 5;
  private drawn: unknown[] = [];
  private timer = 0;

  constructor(private readonly app: App) {
    this.headers = COLUMNS.map(({ name, title }, i) =>
      h("th", { scope: "col", title }, h("button", { type: "button", onclick: () => this.sortBy(i) }, name)));
    this.area = h("div", { class: "area", tabindex: "0", role: "group", "aria-label": "Rows" },
      h("table", {}, h("thead", {}, h("tr", {}, ...this.headers)), this.body), this.more);
    this.element = h("section", { class: "pane list", "aria-label": "Table of points" }, h("header", {}, h("h2", {}, "Points"), this.note), this.area);
  }

  private sortBy(column: number): void {
    this.sort = column;
    this.drawn = [];
    this.show(this.app.store.state);
  }

  private showMore(): void {
    this.most += 5 * ROWS;
    this.drawn = [];
    this.show(this.app.store.state);
  }

  show(state: State): void {
    const { answer, draft, used, selected } = state;
    const wanted = [answer, draft, used, selected];
    if (wanted.every((part, i) => part === this.drawn[i])) return;
    this.drawn = wanted;
    // Not at every step of a drag.
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => this.fill(state), this.body.childElementCount === 0 ? 0 : 120);
  }

  private fill(state: State): void {
    const { draft, answer, used, selected } = state;
    const column = COLUMNS[this.sort]!;
    const fitted = (i: number) => (used[i] ? (answer?.fitted[i] ?? null) : null);
    const sign = column.falling ? -1 : 1;
    const keys = draft.points.map((_, i) => sign * column.key(i, fitted(i), state));
    const order = draft.points.map((_, i) => i).sort((a, b) => keys[a]! - keys[b]! || a - b);
    const shown = order.slice(0, this.most);
    if (selected !== null && !shown.includes(selected) && draft.points[selected]) shown.unshift(selected);
    this.headers.forEach((header, i) => header.setAttribute("aria-sort", i !== this.sort ? "none" : column.falling ? "descending" : "ascending"));
    this.note.textContent = draft.points.length > shown.length ? `${count(shown.length)} of ${count(draft.points.length)}, by ${column.name}` : "";
    const left = draft.points.length - shown.length;
    this.more.hidden = left === 0;
    this.more.textContent = `Show ${count(Math.min(left, 5 * ROWS))} more`;
    const rows = shown.map((i) => {
      const row = h("tr", { class: [i === selected && "chosen", !used[i] && "unused", isOutlier(fitted(i)) && "wrong"].filter(Boolean).join(" ") },
        ...COLUMNS.map(({ text }, place) => place > 0 ? h("td", {}, text(i, fitted(i), state)) :
          h("td", {}, h("button", { type: "button", "aria-label": `Select point ${i + 1}`, "aria-pressed": String(i === selected) }, String(i + 1)))));
      row.addEventListener("click", () => this.choose(i));
      return row;
    });
    const focused = this.body.contains(document.activeElement) ? document.activeElement!.textContent : null;
    this.body.replaceChildren(...rows);
    if (focused) [...this.body.querySelectorAll("button")].find((button) => button.textContent === focused)?.focus();
  }

  private choose(index: number): void {
    const point = this.app.store.state.draft.points[index];
    if (!point) return;
    this.app.select(index);
    this.app.point({ u: Math.round(point.u), v: Math.round(point.v) });
  }
}
