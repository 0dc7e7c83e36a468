//! How often a test repeats something: a few times in `make test`, and more often under `make torture`, which sets
//! `SCAND_TORTURE`.

/// The number in `SCAND_TORTURE`; `None` in the gate.
pub fn asked() -> Option<u64> {
    let number = std::env::var("SCAND_TORTURE").ok()?;
    Some(number.parse().unwrap())
}

/// How often a test does something: `gate` times, or `torture` times the number where more is asked for.
pub fn times(gate: u64, torture: u64) -> u64 {
    asked().map_or(gate, |number| torture * number)
}
