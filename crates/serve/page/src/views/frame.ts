// Maps pixels of the image to the stage: fitted into it, or magnified and moved.

import type { Pixel } from "../state.ts";

const MOST = 40;

export class Frame {
  /** CSS pixels per image pixel. */
  scale = 1;
  private zoom = 1;
  private left = 0;
  private top = 0;
  private width = 1;
  private height = 1;
  private columns = 1;
  private rows = 1;

  get magnified(): boolean {
    return this.zoom > 1.001;
  }

  resize(width: number, height: number, columns: number, rows: number): void {
    const same = columns === this.columns && rows === this.rows;
    const middle = this.pixel(this.width / 2, this.height / 2);
    [this.width, this.height, this.columns, this.rows] = [width, height, columns, rows];
    if (!same) this.zoom = 1;
    this.scale = this.zoom * Math.min(width / columns, height / rows);
    if (this.magnified) {
      this.left = width / 2 - (middle.u + 0.5) * this.scale;
      this.top = height / 2 - (middle.v + 0.5) * this.scale;
    }
    this.settle();
  }

  x = (u: number): number => this.left + (u + 0.5) * this.scale;
  y = (v: number): number => this.top + (v + 0.5) * this.scale;
  pixel = (x: number, y: number): Pixel => ({ u: (x - this.left) / this.scale - 0.5, v: (y - this.top) / this.scale - 0.5 });

  contains(x: number, y: number): boolean {
    const { u, v } = this.pixel(x, y);
    return u >= -0.5 && v >= -0.5 && u <= this.columns - 0.5 && v <= this.rows - 0.5;
  }

  /** Left, top, width and height of the image. */
  box(): [number, number, number, number] {
    return [this.left, this.top, this.columns * this.scale, this.rows * this.scale];
  }

  magnify(factor: number, x: number, y: number): void {
    const at = this.pixel(x, y);
    this.zoom = Math.min(MOST, Math.max(1, this.zoom * factor));
    this.scale = this.zoom * Math.min(this.width / this.columns, this.height / this.rows);
    this.left = x - (at.u + 0.5) * this.scale;
    this.top = y - (at.v + 0.5) * this.scale;
    this.settle();
  }

  move(dx: number, dy: number): void {
    this.left += dx;
    this.top += dy;
    this.settle();
  }

  /** Brings a pixel into sight. */
  reveal(u: number, v: number): void {
    const margin = 24;
    const [x, y] = [this.x(u), this.y(v)];
    this.move(
      Math.max(0, margin - x) - Math.max(0, x - this.width + margin),
      Math.max(0, margin - y) - Math.max(0, y - this.height + margin),
    );
  }

  /** Centres an image smaller than the stage, and keeps a larger one covering the stage. */
  private settle(): void {
    const within = (start: number, size: number, room: number) =>
      size <= room ? (room - size) / 2 : Math.min(0, Math.max(room - size, start));
    this.left = within(this.left, this.columns * this.scale, this.width);
    this.top = within(this.top, this.rows * this.scale, this.height);
  }
}
