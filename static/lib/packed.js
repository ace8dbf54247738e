// An answer in one block of bytes: a JSON head, then float64 numbers (app/sandbox/packed.py says the layout).

/** The head with its arrays filled in: Float64Array, or where readings are missing an Array with null for them. */
export function unpack(buffer) {
  const size = new DataView(buffer).getUint32(0, true);
  const head = new TextDecoder().decode(new Uint8Array(buffer, 4, size));
  const column = ([first, count, holes]) => {
    const values = new Float64Array(buffer, 4 + size + 8 * first, count);
    return holes ? Array.from(values, (v) => (Number.isNaN(v) ? null : v)) : values;
  };
  return JSON.parse(head, (_, value) => (value?.$ ? column(value.$) : value));
}
