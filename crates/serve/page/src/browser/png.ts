// 16-bit grey PNG images of depths, which browsers decode to 8 bits. A text chunk gives the unit, as in files of `lsdc`.

const SIGNATURE = [0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a];
const KEYWORD = "Depth units per metre";
const GREY = 0;

export interface Grey16 {
  readonly width: number;
  readonly height: number;
  readonly values: Uint16Array;
  /** Units per metre; null if the file does not give them. */
  readonly perMetre: number | null;
}

/** Reads an image; null if it is not 16-bit grey, or is damaged. */
export async function read(buffer: ArrayBuffer): Promise<Grey16 | null> {
  const [bytes, view] = [new Uint8Array(buffer), new DataView(buffer)];
  if (bytes.length < 33 || SIGNATURE.some((byte, i) => bytes[i] !== byte)) return null;
  const [width, height] = [view.getUint32(16), view.getUint32(20)];
  // Bit depth, colour type, and the only supported methods of compression, filtering and interlacing.
  if ([16, GREY, 0, 0, 0].some((value, i) => bytes[24 + i] !== value)) return null;
  const data: Uint8Array<ArrayBuffer>[] = [];
  let perMetre: number | null = null;
  for (let at = 8; at + 12 <= bytes.length; ) {
    const end = at + 8 + view.getUint32(at);
    if (end + 4 > bytes.length) return null;
    const [name, body] = [latin1(bytes.subarray(at + 4, at + 8)), bytes.subarray(at + 8, end)];
    if (name === "IDAT") data.push(body);
    const [keyword, text] = name === "tEXt" ? latin1(body).split("\0") : [];
    if (keyword === KEYWORD && Number(text) > 0) perMetre = Number(text);
    at = end + 4;
  }
  const size = 2 * width;
  const rows = await through(new DecompressionStream("deflate"), data).catch(() => null);
  if (rows?.length !== height * (size + 1)) return null;
  const values = new Uint16Array(width * height);
  let above = new Uint8Array(size);
  for (let y = 0; y < height; y++) {
    const row = rows.subarray(y * (size + 1) + 1, (y + 1) * (size + 1));
    if (!restore(rows[y * (size + 1)]!, row, above)) return null;
    for (let x = 0; x < width; x++) values[y * width + x] = 256 * row[2 * x]! + row[2 * x + 1]!;
    above = row;
  }
  return { width, height, values, perMetre };
}

/** Undoes the filter of a row of two-byte pixels in place (PNG, section 9); false if there is no such filter. */
function restore(filter: number, row: Uint8Array, above: Uint8Array): boolean {
  if (filter > 4) return false;
  for (let i = 0; i < row.length; i++) {
    const [left, up, corner] = [i < 2 ? 0 : row[i - 2]!, above[i]!, i < 2 ? 0 : above[i - 2]!];
    row[i]! += [0, left, up, (left + up) >> 1, paeth(left, up, corner)][filter]!;
  }
  return true;
}

function paeth(left: number, up: number, corner: number): number {
  const [a, b, c] = [Math.abs(up - corner), Math.abs(left - corner), Math.abs(left + up - 2 * corner)];
  return a <= b && a <= c ? left : b <= c ? up : corner;
}

/** Encodes an image. */
export async function write({ width, height, values, perMetre }: Grey16): Promise<Blob> {
  const rows = new Uint8Array(height * (2 * width + 1));
  const view = new DataView(rows.buffer);
  values.forEach((value, i) => view.setUint16(2 * i + 1 + Math.floor(i / width), value));
  const header = new DataView(new ArrayBuffer(13));
  header.setUint32(0, width);
  header.setUint32(4, height);
  header.setUint8(8, 16);
  const text = perMetre === null ? [] : [chunk("tEXt", new TextEncoder().encode(`${KEYWORD}\0${perMetre}`))];
  const data = await through(new CompressionStream("deflate"), [rows]);
  const parts = [chunk("IHDR", new Uint8Array(header.buffer)), ...text, chunk("IDAT", data), chunk("IEND", new Uint8Array())];
  return new Blob([Uint8Array.from(SIGNATURE), ...parts], { type: "image/png" });
}

function chunk(name: string, body: Uint8Array): Uint8Array<ArrayBuffer> {
  const bytes = new Uint8Array(12 + body.length);
  const view = new DataView(bytes.buffer);
  view.setUint32(0, body.length);
  bytes.set(new TextEncoder().encode(name), 4);
  bytes.set(body, 8);
  view.setUint32(8 + body.length, crc(bytes.subarray(4, 8 + body.length)));
  return bytes;
}

/** The checksum of a chunk (PNG, annex D). */
function crc(bytes: Uint8Array): number {
  let rest = ~0;
  for (const byte of bytes) {
    rest ^= byte;
    for (let bit = 0; bit < 8; bit++) rest = (rest >>> 1) ^ (rest & 1 ? 0xedb88320 : 0);
  }
  return ~rest >>> 0;
}

const latin1 = (bytes: Uint8Array): string => String.fromCharCode(...bytes.subarray(0, 1000));

async function through(stream: GenericTransformStream, parts: Uint8Array<ArrayBuffer>[]): Promise<Uint8Array<ArrayBuffer>> {
  return new Uint8Array(await new Response(new Blob(parts).stream().pipeThrough(stream)).arrayBuffer());
}
