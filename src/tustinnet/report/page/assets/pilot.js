// A controller as it was designed: a plan with feedback along it, then feedback about its end.

class Pilot {
  constructor({ feedback, plan, gains }) {
    Object.assign(this, { feedback, plan: plan ?? null, gains: gains ?? [] });
    const { gain, x0, u0, integral } = feedback;
    this.previousCount = (gain[0].length - x0.length - integral.length) / u0.length;
    this.reset();
  }

  // Begins anew; at the plan, or only with the feedback that holds its end.
  reset(planned = true) {
    const before = this.plan && planned ? this.plan.before : this.feedback.u0;
    this.k = planned ? 0 : this.gains.length;
    this.integrals = this.feedback.integral.map(() => 0);
    this.previous = Array(this.previousCount).fill(before);
  }

  // The command from now to the next sample, from the state.
  inputs(x) {
    const { gain, x0, u0, lower, upper, integral, periodic } = this.feedback;
    const along = this.k < this.gains.length, matrix = along ? this.gains[this.k] : gain;
    const reference = along ? this.plan.x[this.k] : x0, feed = along ? this.plan.u[this.k] : u0;
    const earlier = (i) => (along && this.k >= i ? this.plan.u[this.k - i] : along ? this.plan.before : u0);
    const error = x0.map((_, i) => {
      const e = x[i] - reference[i];
      return periodic.includes(i) ? wrapped(e) : e;
    });
    const z = [...error, ...(along ? [] : this.integrals),
      ...this.previous.flatMap((u, i) => u.map((value, j) => value - earlier(i + 1)[j]))];
    const want = feed.map((value, j) => value - matrix[j].reduce((sum, g, i) => sum + g * z[i], 0));
    const command = want.map((value, j) => Math.min(Math.max(value, lower[j]), upper[j]));
    if (!along && command.every((value, j) => value === want[j]))
      this.integrals = this.integrals.map((s, i) => s + this.feedback.period * error[integral[i]]);
    if (this.previousCount) this.previous = [command, ...this.previous.slice(0, -1)];
    this.k += 1;
    return command;
  }
}

// For checks: the commands of the page's controller for a series of states.
globalThis.commandsFor = (states) => {
  const pilot = new Pilot(data.controller);
  return states.map((x) => pilot.inputs(x));
};
