// Writes the licences of what is bundled into dist/licences.txt: of the packages that package.json depends on, and of
// those that they bring along.
import { readFileSync, readdirSync, writeFileSync } from "node:fs";

const read = (path) => readFileSync(new URL(path, import.meta.url), "utf8");
const todo = Object.keys(JSON.parse(read("package.json")).dependencies);
const texts = new Map();
while (todo.length > 0) {
  const name = todo.shift();
  if (texts.has(name) || name.startsWith("@types/")) continue;
  const folder = `node_modules/${name}/`;
  const about = JSON.parse(read(`${folder}package.json`));
  const files = readdirSync(new URL(folder, import.meta.url));
  const licence = files.find((file) => /^licen[cs]e/i.test(file));
  const text = licence ? read(folder + licence) : `${about.license} (the package has no file with its text)`;
  texts.set(name, `${name} ${about.version}, ${about.license}\n\n${text.trim()}\n`);
  todo.push(...Object.keys(about.dependencies ?? {}));
}
const rule = `\n${"-".repeat(80)}\n\n`;
const all = [...texts.keys()].sort().map((name) => texts.get(name));
writeFileSync(new URL("dist/licences.txt", import.meta.url), all.join(rule));
console.log(`licences of ${[...texts.keys()].sort().join(", ")}`);
