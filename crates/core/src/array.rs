//! Short arrays for inner loops. What the standard library has for them (`map`, `from_fn`) is a call for each
//! array unless a program is optimised as a whole, which a build has no time for; these are what they do.

/// The values of `f` for a triangle's corners, a pixel's channels or a point's coordinates.
#[inline(always)]
pub fn three<T>(mut f: impl FnMut(usize) -> T) -> [T; 3] {
    [f(0), f(1), f(2)]
}

/// The values of `f` for the two coordinates of a pixel.
#[inline(always)]
pub fn two<T>(mut f: impl FnMut(usize) -> T) -> [T; 2] {
    [f(0), f(1)]
}
