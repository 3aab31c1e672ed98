// A controller as it was designed: a plan with feedback along it, then feedback about its end; after a
// fall feedback about the plan's start, then the plan again.

class Pilot {
  constructor({ feedback, plan, gains, recovery }) {
    Object.assign(this, { feedback, plan: plan ?? null, gains: gains ?? [], recovery: recovery ?? null });
    const { gain, x0, u0, integral } = feedback;
    this.previousCount = (gain[0].length - x0.length - integral.length) / u0.length;
    this.reset();
  }

  // Begins anew; at the plan, or only with the feedback that holds its end.
  reset(planned = true) {
    const before = this.plan && planned ? this.plan.before : this.feedback.u0;
    this.phase = this.plan && planned ? "plan" : "hold";
    this.k = 0; // of the plan
    this.integrals = this.feedback.integral.map(() => 0);
    this.previous = Array(this.previousCount).fill(before);
  }

  errors(x, goal) {
    return goal.map((value, i) => (this.feedback.periodic.includes(i) ? wrapped(x[i] - value) : x[i] - value));
  }

  // Goes on to the next phase where that is due at a state.
  choosePhase(x) {
    if (this.phase === "plan" && this.k === this.plan.u.length) this.phase = "hold";
    if (!this.recovery) return;
    const beyond = (errors, bounds) => errors.some((e, i) => bounds[i] > 0 && Math.abs(e) > bounds[i]);
    if (this.phase === "hold" && beyond(this.errors(x, this.feedback.x0), this.recovery.fallen_beyond)) {
      this.phase = "settle";
      this.integrals = this.integrals.map(() => 0);
    }
    if (this.phase === "settle" && !beyond(this.errors(x, this.plan.x[0]), this.recovery.settled_within)) {
      this.phase = "plan";
      this.k = 0;
    }
  }

  // The command from now to the next sample, from the state.
  inputs(x) {
    this.choosePhase(x);
    const { lower, upper, integral } = this.feedback, { plan, k } = this;
    const along = this.phase === "plan", held = this.phase === "hold";
    const about = held ? this.feedback : this.recovery?.feedback;
    const matrix = along ? this.gains[k] : about.gain, feed = along ? plan.u[k] : about.u0;
    const earlier = (i) => (!along ? about.u0 : k >= i ? plan.u[k - i] : plan.before);
    const error = this.errors(x, along ? plan.x[k] : about.x0);
    const z = [...error, ...(held ? this.integrals : []),
      ...this.previous.flatMap((u, i) => u.map((value, j) => value - earlier(i + 1)[j]))];
    const want = feed.map((value, j) => value - matrix[j].reduce((sum, g, i) => sum + g * z[i], 0));
    const command = want.map((value, j) => Math.min(Math.max(value, lower[j]), upper[j]));
    if (held && command.every((value, j) => value === want[j]))
      this.integrals = this.integrals.map((s, i) => s + this.feedback.period * error[integral[i]]);
    if (this.previousCount) this.previous = [command, ...this.previous.slice(0, -1)];
    if (along) this.k += 1;
    return command;
  }
}

// For checks: the commands of the page's controller for a series of states.
globalThis.commandsFor = (states) => {
  const pilot = new Pilot(data.controller);
  return states.map((x) => pilot.inputs(x));
};
