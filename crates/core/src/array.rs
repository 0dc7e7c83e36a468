//! Functions on short arrays for inner loops. The compiler does not inline those of the standard library (`map`,
//! `from_fn`) unless it optimises the whole program at once, which would make a build too slow.

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
