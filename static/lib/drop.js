// What was dropped or picked, as uploads: a run folder (or its loose files together) becomes one zip, the rest stays.

import { zip } from "./zip.js";

const TABLE = /\.(csv|parquet)$/i;

function entriesOf(directory) {
  const reader = directory.createReader();
  const all = [];
  return new Promise((resolve, reject) => {
    const next = () =>
      reader.readEntries((some) => {
        if (some.length === 0) return resolve(all);
        all.push(...some);
        return next();
      }, reject);
    next();
  });
}

const fileOf = (entry) => new Promise((resolve, reject) => entry.file(resolve, reject));

/** Run folders in a dropped folder: itself where it holds run.json or tables, else those below, two levels deep. */
async function foldersIn(directory, depth = 0) {
  const entries = await entriesOf(directory);
  const files = await Promise.all(entries.filter((e) => e.isFile && !e.name.startsWith(".")).map(fileOf));
  if (files.some((f) => f.name === "run.json" || TABLE.test(f.name))) return [{ name: directory.name, files }];
  if (depth >= 2) return [];
  const below = await Promise.all(entries.filter((e) => e.isDirectory).map((e) => foldersIn(e, depth + 1)));
  return below.flat();
}

/** Loose files: those beside a run.json are one run. */
function group(files) {
  const description = files.find((f) => f.name === "run.json");
  if (!description) return { folders: [], single: files };
  const belongs = files.filter((f) => f === description || TABLE.test(f.name));
  return { folders: [{ name: "run", files: belongs }], single: files.filter((f) => !belongs.includes(f)) };
}

/** A list of {name, file()}: `file` makes the File to send (a zip is made only when its turn comes). */
export async function incoming(transfer) {
  const entries = [...(transfer.items ?? [])].map((i) => i.webkitGetAsEntry?.()).filter(Boolean);
  const directories = entries.filter((e) => e.isDirectory);
  const loose = entries.length ? await Promise.all(entries.filter((e) => e.isFile).map(fileOf)) : [...transfer.files];
  const { folders, single } = group(loose);
  for (const directory of directories) folders.push(...(await foldersIn(directory)));
  return [
    ...folders.map(({ name, files }) => ({ name, file: () => zip(name, files.map((f) => ({ name: f.name, file: f }))) })),
    ...single.map((f) => ({ name: f.name, file: async () => f })),
  ];
}
