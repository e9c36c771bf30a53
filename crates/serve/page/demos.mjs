// Ray-traced demo scenes for the page as static files: images, and points with simulated errors. The output depends on this
// file alone.
import { crc32, deflateSync } from "node:zlib";

const WIDTH = 304;
const HEIGHT = 228;
const FOCAL = 260;
/** Rays per pixel along each axis. */
const RAYS = 2;
const SUN = [-0.4, -0.8, -0.45];

/** Hashes three integers to a number from 0 to 1. */
function random(a, b, c) {
  let h = Math.imul(a | 0, 0x85ebca6b) ^ Math.imul(b | 0, 0xc2b2ae35) ^ Math.imul(c | 0, 0x27d4eb2f);
  h = Math.imul(h ^ (h >>> 15), 0x2c1b3c6d);
  h = Math.imul(h ^ (h >>> 12), 0x297a2d39);
  return ((h ^ (h >>> 15)) >>> 0) / 2 ** 32;
}

// Surfaces: `hit(ray)` is the depth along the axis and the normal; x is right, y down, z away from the camera.
const plane = (axis, at, colour) => ({
  colour,
  hit: (ray) => ({ z: at / ray[axis], normal: [0, 1, 2].map((a) => (a === axis ? -Math.sign(ray[axis]) : 0)) }),
});
const box = (low, high, colour) => ({
  colour,
  hit(ray) {
    let [from, to, side] = [0, Infinity, 2];
    for (let axis = 0; axis < 3; axis++) {
      const [a, b] = [low[axis] / ray[axis], high[axis] / ray[axis]];
      if (Math.min(a, b) > from) [from, side] = [Math.min(a, b), axis];
      to = Math.min(to, Math.max(a, b));
    }
    return from < to ? { z: from, normal: [0, 1, 2].map((a) => (a === side ? -Math.sign(ray[a]) : 0)) } : null;
  },
});
const ball = (centre, radius, colour) => ({
  colour,
  hit(ray) {
    const [along, across] = [dot(ray, centre) / dot(ray, ray), dot(centre, centre) - radius ** 2];
    const root = along ** 2 - across / dot(ray, ray);
    if (root < 0) return null;
    const z = along - Math.sqrt(root);
    return { z, normal: centre.map((c, axis) => (ray[axis] * z - c) / radius) };
  },
});
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

// Colours: functions of the position.
const plain = (...rgb) => () => rgb;
const checked = (size, a, b) => ([x, y, z]) => (([x, y, z].reduce((sum, value) => sum + Math.floor(value / size + 0.003), 0) & 1) === 0 ? a : b);
const planks = (width, rgb) => ([x, , z]) => {
  const [row, shift] = [Math.floor(x / width), Math.floor(x / width) * 0.7];
  const shade = 0.75 + 0.25 * random(row, Math.floor((z + shift) / 1.9), 3) - (x / width - row < 0.04 ? 0.25 : 0);
  return rgb.map((c) => c * shade);
};

function nearest(surfaces, ray) {
  let best = null;
  for (const surface of surfaces) {
    const hit = surface.hit(ray);
    if (hit && hit.z > 0.1 && (!best || hit.z < best.z)) best = { ...hit, surface };
  }
  return best;
}

const rayOf = (u, v) => [(u - (WIDTH - 1) / 2) / FOCAL, (v - (HEIGHT - 1) / 2) / FOCAL, 1];

function picture(surfaces) {
  const pixels = Buffer.alloc(3 * WIDTH * HEIGHT);
  for (let v = 0; v < HEIGHT; v++) {
    for (let u = 0; u < WIDTH; u++) {
      const sum = [0, 0, 0];
      for (let i = 0; i < RAYS ** 2; i++) {
        const ray = rayOf(u + ((i % RAYS) + 0.5) / RAYS - 0.5, v + (Math.floor(i / RAYS) + 0.5) / RAYS - 0.5);
        const { z, normal, surface } = nearest(surfaces, ray);
        const place = ray.map((value) => value * z);
        const light = (0.55 + 0.45 * Math.max(0, dot(normal, SUN))) / (1 + 0.03 * z);
        surface.colour(place).forEach((c, axis) => (sum[axis] += c * light));
      }
      const noise = 6 * (random(u, v, 7) - 0.5);
      sum.forEach((c, axis) => (pixels[3 * (v * WIDTH + u) + axis] = Math.min(255, Math.max(0, c / RAYS ** 2 + noise))));
    }
  }
  return png(pixels);
}

function png(pixels) {
  const chunk = (kind, data) => {
    const body = Buffer.concat([Buffer.from(kind, "latin1"), data]);
    const ends = Buffer.alloc(8);
    ends.writeUInt32BE(data.length, 0);
    ends.writeUInt32BE(crc32(body), 4);
    return Buffer.concat([ends.subarray(0, 4), body, ends.subarray(4)]);
  };
  const header = Buffer.alloc(13);
  header.writeUInt32BE(WIDTH, 0);
  header.writeUInt32BE(HEIGHT, 4);
  header.set([8, 2, 0, 0, 0], 8);
  const rows = Array.from({ length: HEIGHT }, (_, v) => [Buffer.of(0), pixels.subarray(3 * WIDTH * v, 3 * WIDTH * (v + 1))]);
  return Buffer.concat([
    Buffer.from("\x89PNG\r\n\x1a\n", "latin1"),
    chunk("IHDR", header), chunk("IDAT", deflateSync(Buffer.concat(rows.flat()), { level: 9 })), chunk("IEND", Buffer.alloc(0)),
  ]);
}

/** Depths at pixels, rounded to millimetres, with errors proportional to the depth. */
function measured(surfaces, pixels, share) {
  return pixels.map(([u, v], i) => {
    const error = share * (random(i, 1, 5) + random(i, 2, 5) + random(i, 3, 5) - 1.5);
    return [u, v, Number((nearest(surfaces, rayOf(u, v)).z * (1 + error)).toFixed(3))];
  });
}

function warehouse() {
  const surfaces = [
    plane(1, 1.6, checked(1.2, [150, 148, 140], [136, 134, 128])), plane(1, -2.9, checked(2.5, [190, 195, 200], [172, 178, 185])),
    plane(0, -4.2, plain(165, 160, 150)), plane(0, 4.2, plain(165, 160, 150)), plane(2, 19, checked(0.8, [180, 130, 105], [168, 120, 98])),
    box([-0.9, 0.5, 9], [0.35, 1.6, 10.2], plain(190, 150, 95)), box([-0.75, -0.2, 9.2], [0.2, 0.5, 10.1], plain(175, 135, 85)),
    box([1.1, 1.0, 5.2], [1.7, 1.6, 5.9], plain(60, 105, 160)),
  ];
  for (const side of [-1, 1]) {
    for (let bay = 0; bay < 6; bay++) {
      const [near, far] = [3.4 + 2.5 * bay, 3.4 + 2.5 * bay + 2.3];
      const across = (a, b) => [Math.min(side * a, side * b), Math.max(side * a, side * b)];
      const [left, right] = across(2.2, 3.6);
      for (const top of [-1.75, -0.65, 0.45, 1.5]) {
        surfaces.push(box([left, top, near], [right, top + 0.1, far + 0.2], plain(200, 95, 45)));
        for (let i = 0; i < 3; i++) {
          const key = [bay * 4 + i, Math.round(10 * top), side];
          if (random(...key) < 0.25) continue;
          const [a, b] = across(2.25 + 0.3 * random(...key.map((k) => k + 11)), 3.5);
          const height = 0.45 + 0.5 * random(...key.map((k) => k + 5));
          const shade = 0.6 + 0.4 * random(...key.map((k) => k + 17));
          const rgb = [[205, 165, 110], [90, 125, 165], [165, 175, 160]][i].map((c) => c * shade);
          surfaces.push(box([a, top - height, near + 0.1 + 0.75 * i], [b, top, near + 0.75 * i + 0.7], plain(...rgb)));
        }
      }
      const [post, edge] = across(2.15, 2.27);
      surfaces.push(box([post, -2.9, near - 0.12], [edge, 1.6, near], plain(45, 75, 130)));
    }
  }
  // Sixteen beams, every third column.
  const beams = Array.from({ length: 16 }, (_, i) => Math.round((HEIGHT - 1) / 2 + FOCAL * Math.tan(((i - 6.5) * 2.4 * Math.PI) / 180)));
  const pixels = beams.flatMap((v) => Array.from({ length: 101 }, (_, i) => [1 + 3 * i, v])).filter(([, v]) => v >= 0 && v < HEIGHT);
  return { surfaces, points: measured(surfaces, pixels, 0.004) };
}

function desk() {
  const wood = planks(0.21, [196, 150, 104]);
  const surfaces = [
    plane(2, 2.6, checked(0.31, [214, 210, 200], [206, 202, 193])), plane(0, -1.9, plain(150, 170, 165)), plane(0, 2.1, plain(190, 185, 170)),
    plane(1, 1.3, plain(95, 90, 86)), plane(1, -1.5, plain(225, 224, 220)),
    box([-1.25, 0.42, 0.95], [1.2, 0.48, 2.2], wood),
    box([-0.62, -0.18, 1.75], [0.3, 0.36, 1.8], plain(35, 38, 44)), box([-0.2, 0.3, 1.7], [-0.1, 0.42, 1.85], plain(60, 62, 66)),
    box([-0.55, 0.39, 1.25], [0.2, 0.42, 1.5], checked(0.05, [205, 205, 205], [180, 180, 182])),
    box([0.55, 0.29, 1.5], [0.95, 0.36, 1.85], plain(150, 45, 45)), box([0.58, 0.22, 1.52], [0.92, 0.29, 1.83], plain(50, 90, 60)),
    box([0.6, 0.36, 1.5], [0.98, 0.42, 1.9], plain(60, 80, 140)),
    ball([0.47, 0.3, 1.3], 0.12, plain(215, 120, 50)), ball([-0.9, 0.24, 1.5], 0.18, checked(0.09, [230, 200, 70], [80, 120, 180])),
    box([-1.9, -0.35, 2.2], [-0.85, -0.28, 2.6], wood), box([-1.5, -0.75, 2.3], [-1.2, -0.35, 2.55], plain(130, 95, 140)),
    box([0.75, -0.9, 2.56], [1.7, -0.1, 2.6], checked(0.16, [110, 150, 190], [235, 225, 205])),
  ];
  const cells = Array.from({ length: 48 }, (_, i) => [(i % 8) * 38, Math.floor(i / 8) * 38]);
  const pixels = cells.map(([u, v], i) => [u + Math.floor(37 * random(i, 5, 9)), Math.min(HEIGHT - 1, v + Math.floor(37 * random(i, 6, 9)))]);
  return { surfaces, points: measured(surfaces, pixels, 0.005) };
}

/** Name, title, PNG and points (u, v, depth in metres) of each scene. */
export const scenes = () => [
  { name: "warehouse", title: "A warehouse, sixteen beams of a laser scanner", ...warehouse() },
  { name: "desk", title: "A desk, 48 depths", ...desk() },
].map(({ surfaces, ...scene }) => ({ ...scene, image: picture(surfaces) }));
