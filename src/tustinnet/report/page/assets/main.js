// The page begins.

setTheme(document.documentElement.dataset.theme ?? (wanted.matches ? "dark" : "light"));
beginClock();
beginStage();
clock.choose(0);
performance.mark("first-frame");
timeCharts();
aheadChart();
residualCharts();
stateCharts();
searchCharts();
trainingCharts();
beginPlots();
beginPlayground();
if (!matchMedia("(prefers-reduced-motion: reduce)").matches) clock.play();
document.documentElement.dataset.ready = "yes";
