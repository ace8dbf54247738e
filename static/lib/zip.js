// A folder as one zip without compression, made of slices of its files: nothing is held in memory but the directory.

const LIMIT = 0xffffffff;
const TABLE = Uint32Array.from({ length: 256 }, (_, n) => {
  let c = n;
  for (let k = 0; k < 8; k++) c = c & 1 ? 0xedb88320 ^ (c >>> 1) : c >>> 1;
  return c >>> 0;
});

async function crc32(file) {
  let crc = LIMIT;
  const reader = file.stream().getReader();
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return (crc ^ LIMIT) >>> 0;
    for (let i = 0; i < value.length; i++) crc = TABLE[(crc ^ value[i]) & 255] ^ (crc >>> 8);
  }
}

/** Little-endian fields: [[bytes, value], ...]. */
function record(fields) {
  const size = fields.reduce((sum, [bytes]) => sum + bytes, 0);
  const view = new DataView(new ArrayBuffer(size));
  let at = 0;
  for (const [bytes, value] of fields) {
    if (bytes === 2) view.setUint16(at, value, true);
    else view.setUint32(at, value, true);
    at += bytes;
  }
  return view.buffer;
}

const common = (crc, size, name) => [[2, 20], [2, 0x0800], [2, 0], [2, 0], [2, 0x21], [4, crc], [4, size], [4, size], [2, name.length]];

/** files: [{name, file}] -> a File named `${folder}.zip`. */
export async function zip(folder, files) {
  const total = files.reduce((sum, { file }) => sum + file.size, 0);
  if (total > LIMIT - (1 << 20)) throw new Error("The folder is over 4 GB: zip it yourself, and drop the zip.");
  const parts = [];
  const directory = [];
  let offset = 0;
  for (const { name, file } of files) {
    const encoded = new TextEncoder().encode(name);
    const fields = common(await crc32(file), file.size, encoded);
    const head = record([[4, 0x04034b50], ...fields, [2, 0]]);
    parts.push(head, encoded, file);
    directory.push(record([[4, 0x02014b50], [2, 20], ...fields, [2, 0], [2, 0], [2, 0], [2, 0], [4, 0], [4, offset]]), encoded);
    offset += head.byteLength + encoded.length + file.size;
  }
  const size = directory.reduce((sum, part) => sum + (part.byteLength ?? part.length), 0);
  const end = record([[4, 0x06054b50], [2, 0], [2, 0], [2, files.length], [2, files.length], [4, size], [4, offset], [2, 0]]);
  const newest = Math.max(...files.map(({ file }) => file.lastModified ?? 0));
  return new File([...parts, ...directory, end], `${folder}.zip`, { type: "application/zip", lastModified: newest });
}
