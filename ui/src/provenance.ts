// Where the parts of a model's surface come from: the names of the numbers that a model's file has. The catalogue has
// their words (`from_NAME`), the viewer their colours; both are those of previews, and a test of scand compares them.
export const PROVENANCES = ["hull", "carved", "restored", "bridged", "unseen", "table"] as const;
