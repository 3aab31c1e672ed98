// Colours and lines, as the style sheet has them.

const DASHES = [[9, 3], [2, 3], [9, 3, 2, 3], [5, 2], [14, 4]];
let colours = {};
const repaint = new Set(); // what is drawn anew when colours change

function readColours() {
  const style = getComputedStyle(document.documentElement);
  const names = ["paper", "ink", "quiet", "line", "accent", "grey", "band", "input",
    "m0", "m1", "m2", "m3", "m4"];
  colours = Object.fromEntries(names.map((n) => [n, style.getPropertyValue(`--${n}`).trim()]));
}

const colourOf = (model) => colours[`m${model % 5}`];
const dashOf = (model) => DASHES[model % DASHES.length];
// a colour #rrggbb that lets through what is behind it
const faint = (colour, share) => colour + Math.round(255 * share).toString(16).padStart(2, "0");

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  $("theme").textContent = name === "dark" ? "Light" : "Dark";
  $("theme").setAttribute("aria-label", `Switch to the ${name === "dark" ? "light" : "dark"} colours`);
  readColours();
  for (const draw of repaint) draw();
}

const wanted = matchMedia("(prefers-color-scheme: dark)");
wanted.addEventListener("change", () => setTheme(wanted.matches ? "dark" : "light"));
$("theme").addEventListener("click", () =>
  setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));

// paper is white
let before = null;
addEventListener("beforeprint", () => {
  before = document.documentElement.dataset.theme;
  document.documentElement.classList.add("printed");
  setTheme("light");
});
addEventListener("afterprint", () => {
  document.documentElement.classList.remove("printed");
  setTheme(before);
});

const sizes = new WeakMap(); // of canvases: to ask for one while things move costs a layout
const watchSizes = new ResizeObserver((all) => {
  for (const { target, contentRect: { width, height } } of all)
    sizes.set(target, [Math.round(width), Math.round(height)]);
});

function sizeOf(canvas) {
  if (!sizes.has(canvas)) watchSizes.observe(canvas);
  else if (clock.playing) return sizes.get(canvas);
  return [canvas.clientWidth, canvas.clientHeight];
}

// A canvas that is as sharp as the screen, and its size in CSS pixels.
function sharp(canvas) {
  const [width, height] = sizeOf(canvas), scale = devicePixelRatio || 1;
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const context = canvas.getContext("2d");
  context.setTransform(scale, 0, 0, scale, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}
