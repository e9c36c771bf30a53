// The virtual camera of the cloud. Axes: x right, y down, z forwards.

import type { Orbit } from "../model/settings.ts";

/** A 4 x 4 matrix in column-major order, as WebGL reads it. */
export type Matrix = Float32Array;

export interface Eye {
  readonly clip: Matrix;
  /** Focal length in pixels of the screen. */
  readonly focal: number;
}

/** The eye of an orbit around a target, which without a shift is on the camera's axis at a depth of `middle` metres. */
export function eye(orbit: Orbit, middle: number, tangent: number, width: number, height: number): Eye {
  const [sy, cy, sp, cp] = [Math.sin(orbit.yaw), Math.cos(orbit.yaw), Math.sin(orbit.pitch), Math.cos(orbit.pitch)];
  // Rows of the rotation: the right, down and forward directions of the eye.
  const right = [cy, 0, sy];
  const down = [sy * sp, cp, -cy * sp];
  const ahead = [-sy * cp, sp, cy * cp];
  const away = orbit.distance * middle;
  const target = [orbit.x * middle, orbit.y * middle, (1 + orbit.z) * middle];
  const from = target.map((value, axis) => value - away * ahead[axis]!);
  const shift = (axis: number[]) => -(axis[0]! * from[0]! + axis[1]! * from[1]! + axis[2]! * from[2]!);
  const near = 0.02 * middle;
  const far = 60 * middle;
  const fy = 1 / tangent;
  const fx = (fy * height) / width;
  const depth = (far + near) / (far - near);
  const lift = (-2 * far * near) / (far - near);
  const clip = new Float32Array(16);
  for (let axis = 0; axis < 4; axis++) {
    const of = (part: number[]) => (axis < 3 ? part[axis]! : shift(part));
    clip[4 * axis] = fx * of(right);
    clip[4 * axis + 1] = -fy * of(down);
    clip[4 * axis + 2] = depth * of(ahead) + (axis === 3 ? lift : 0);
    clip[4 * axis + 3] = of(ahead);
  }
  return { clip, focal: (fy * height) / 2 };
}

/** Projects a point to the screen; null if it is behind the eye. */
export function projected({ clip }: Eye, [x, y, z]: readonly [number, number, number], width: number, height: number): [number, number] | null {
  const row = (i: number) => clip[i]! * x + clip[4 + i]! * y + clip[8 + i]! * z + clip[12 + i]!;
  const w = row(3);
  return w > 0 ? [(row(0) / w + 1) * 0.5 * width, (1 - row(1) / w) * 0.5 * height] : null;
}

/** The orbit after a drag, which is given relative to the height of the screen. */
export function turned(orbit: Orbit, dx: number, dy: number): Orbit {
  const most = 1.5;
  return { ...orbit, yaw: orbit.yaw - dx * 3, pitch: Math.min(most, Math.max(-most, orbit.pitch + dy * 3)) };
}

export function shifted(orbit: Orbit, dx: number, dy: number, tangent: number): Orbit {
  const [sy, cy, sp, cp] = [Math.sin(orbit.yaw), Math.cos(orbit.yaw), Math.sin(orbit.pitch), Math.cos(orbit.pitch)];
  const [a, b] = [-2 * tangent * orbit.distance * dx, -2 * tangent * orbit.distance * dy];
  return { ...orbit, x: orbit.x + a * cy + b * sy * sp, y: orbit.y + b * cp, z: orbit.z + a * sy - b * cy * sp };
}

export const nearer = (orbit: Orbit, factor: number): Orbit => ({
  ...orbit,
  distance: Math.min(12, Math.max(0.05, orbit.distance / factor)),
});
