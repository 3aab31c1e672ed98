// a program for the check: a line with state and inputs in, a line with the next state out
import { createInterface } from "node:readline";
import { pathToFileURL } from "node:url";
const { init, step } = await import(pathToFileURL(process.argv[1]).href);
for await (const line of createInterface({ input: process.stdin })) {
  const { x, u } = JSON.parse(line);
  console.log(JSON.stringify(Array.from(step(init(x), u).x)));
}
