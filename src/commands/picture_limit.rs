//! The largest picture of a camera that a confined process decodes.

/// Most pixels of a picture.
const MOST_PIXELS: usize = 50_000_000;

/// Checks a picture's width and height in pixels before it is decoded.
///
/// # Errors
/// If it has more pixels than any camera's.
pub(super) fn checked((width, height): (usize, usize)) -> anyhow::Result<(usize, usize)> {
    anyhow::ensure!(
        width.saturating_mul(height) <= MOST_PIXELS,
        "the picture has {width}x{height} pixels, expected at most {MOST_PIXELS} pixels"
    );
    Ok((width, height))
}
