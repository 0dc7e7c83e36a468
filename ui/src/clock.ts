// How much time passed, by the monotonic or by the wall clock, whichever shows more: the first stands still while a
// tablet sleeps, and the second may be set back.

/** A moment by both clocks. */
export interface Moment {
  monotonic: number;
  wall: number;
}

export function moment(): Moment {
  return { monotonic: performance.now(), wall: Date.now() };
}

/** Milliseconds since a moment. */
export function since({ monotonic, wall }: Moment): number {
  return Math.max(performance.now() - monotonic, Date.now() - wall);
}
