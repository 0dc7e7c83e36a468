// How the rig is configured, as far as the daemon tells it: what models are made with from now on. A daemon of an
// earlier version tells nothing of that.
import type { Backlog } from "./api";

/** From how many hours on a model has the age of its background pictures as a reason: the lower limit of amber and red.
 * Infinity if no age is one; null if that is not known. */
export function platesLimit(models: Backlog | null): number | null {
  const limits = models?.settings?.["verdict.background_age_h"];
  if (typeof limits !== "object" || limits === null) return null;
  const known = Object.values(limits).filter((limit): limit is number => typeof limit === "number");
  return Math.min(Infinity, ...known);
}
