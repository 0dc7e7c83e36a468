//! Completes the frames of MJPEG cameras to JPEG files: many cameras leave out the Huffman tables, which are always the
//! same (those of ITU-T T.81, annex K.3). It turns bytes into bytes, and touches no device.

/// Where something has to be put into a frame, so that it is a JPEG file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Jpeg {
    /// Where its end is, after the mark that ends it.
    pub end: usize,
    /// Where the tables belong, where they are missing.
    pub tables_at: Option<usize>,
}

/// Parses a frame up to the beginning of its image data.
///
/// # Errors
/// A message, if it is not a complete JPEG file.
pub(super) fn inspect(frame: &[u8]) -> Result<Jpeg, String> {
    if !frame.starts_with(&[0xff, 0xd8]) {
        return Err("it does not begin as a JPEG file does".into());
    }
    let mut at = 2;
    let mut has_tables = false;
    loop {
        let Some(&[mark, kind, high, low]) = frame.get(at..).and_then(|f| f.first_chunk()) else {
            return Err("it ends before its image data".into());
        };
        if mark != 0xff {
            return Err(format!("its byte {at} is {mark:#04x}, expected a marker"));
        }
        match kind {
            // Padding.
            0xff => at += 1,
            0xc4 => has_tables = true,
            0xd9 => return Err("it ends before its image data".into()),
            _ => {}
        }
        if kind == 0xff {
            continue;
        }
        if kind == 0xda {
            return Ok(Jpeg {
                end: end(frame)?,
                tables_at: (!has_tables).then_some(at),
            });
        }
        at += 2 + usize::from(u16::from_be_bytes([high, low])).max(2);
    }
}

/// The end of the file; some drivers fill up what is behind it.
fn end(frame: &[u8]) -> Result<usize, String> {
    let filled = frame
        .iter()
        .rposition(|&b| b != 0)
        .map_or(0, |last| last + 1);
    match frame[..filled].windows(2).rposition(|w| w == [0xff, 0xd9]) {
        // Within the last bytes; anything else is a picture that was cut off behind a smaller one.
        Some(at) if filled - at <= 64 => Ok(at + 2),
        _ => Err("its end is missing".into()),
    }
}

/// The parts that follow each other in the complete file.
pub(super) fn parts<'a>(frame: &'a [u8], jpeg: &Jpeg) -> [&'a [u8]; 3] {
    match jpeg.tables_at {
        None => [&frame[..jpeg.end], &[], &[]],
        Some(at) => [&frame[..at], &HUFFMAN_TABLES, &frame[at..jpeg.end]],
    }
}

/// Bits of the four tables' codes and their values, as ITU-T T.81, tables K.3 to K.6, give them.
const LUMINANCE_DC: ([u8; 16], [u8; 12]) = (
    [0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0],
    [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11],
);
const CHROMINANCE_DC: ([u8; 16], [u8; 12]) = (
    [0, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0],
    [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11],
);
const LUMINANCE_AC: ([u8; 16], [u8; 162]) = (
    [0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 125],
    [
        0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13, 0x51, 0x61,
        0x07, 0x22, 0x71, 0x14, 0x32, 0x81, 0x91, 0xa1, 0x08, 0x23, 0x42, 0xb1, 0xc1, 0x15, 0x52,
        0xd1, 0xf0, 0x24, 0x33, 0x62, 0x72, 0x82, 0x09, 0x0a, 0x16, 0x17, 0x18, 0x19, 0x1a, 0x25,
        0x26, 0x27, 0x28, 0x29, 0x2a, 0x34, 0x35, 0x36, 0x37, 0x38, 0x39, 0x3a, 0x43, 0x44, 0x45,
        0x46, 0x47, 0x48, 0x49, 0x4a, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5a, 0x63, 0x64,
        0x65, 0x66, 0x67, 0x68, 0x69, 0x6a, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7a, 0x83,
        0x84, 0x85, 0x86, 0x87, 0x88, 0x89, 0x8a, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99,
        0x9a, 0xa2, 0xa3, 0xa4, 0xa5, 0xa6, 0xa7, 0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6,
        0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3, 0xc4, 0xc5, 0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3,
        0xd4, 0xd5, 0xd6, 0xd7, 0xd8, 0xd9, 0xda, 0xe1, 0xe2, 0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8,
        0xe9, 0xea, 0xf1, 0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8, 0xf9, 0xfa,
    ],
);
const CHROMINANCE_AC: ([u8; 16], [u8; 162]) = (
    [0, 2, 1, 2, 4, 4, 3, 4, 7, 5, 4, 4, 0, 1, 2, 119],
    [
        0x00, 0x01, 0x02, 0x03, 0x11, 0x04, 0x05, 0x21, 0x31, 0x06, 0x12, 0x41, 0x51, 0x07, 0x61,
        0x71, 0x13, 0x22, 0x32, 0x81, 0x08, 0x14, 0x42, 0x91, 0xa1, 0xb1, 0xc1, 0x09, 0x23, 0x33,
        0x52, 0xf0, 0x15, 0x62, 0x72, 0xd1, 0x0a, 0x16, 0x24, 0x34, 0xe1, 0x25, 0xf1, 0x17, 0x18,
        0x19, 0x1a, 0x26, 0x27, 0x28, 0x29, 0x2a, 0x35, 0x36, 0x37, 0x38, 0x39, 0x3a, 0x43, 0x44,
        0x45, 0x46, 0x47, 0x48, 0x49, 0x4a, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5a, 0x63,
        0x64, 0x65, 0x66, 0x67, 0x68, 0x69, 0x6a, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7a,
        0x82, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89, 0x8a, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97,
        0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5, 0xa6, 0xa7, 0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4,
        0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3, 0xc4, 0xc5, 0xc6, 0xc7, 0xc8, 0xc9, 0xca,
        0xd2, 0xd3, 0xd4, 0xd5, 0xd6, 0xd7, 0xd8, 0xd9, 0xda, 0xe2, 0xe3, 0xe4, 0xe5, 0xe6, 0xe7,
        0xe8, 0xe9, 0xea, 0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8, 0xf9, 0xfa,
    ],
);

/// Bytes of the segment: its mark and length, and of each table a byte of its kind, 16 counts and the values.
const LENGTH: usize = 4 + 2 * (17 + 12) + 2 * (17 + 162);

/// The tables as a segment of a file.
const HUFFMAN_TABLES: [u8; LENGTH] = segment();

const fn segment() -> [u8; LENGTH] {
    let mut bytes = [0; LENGTH];
    let length = (LENGTH - 2) as u16;
    bytes[0] = 0xff;
    bytes[1] = 0xc4;
    bytes[2] = (length >> 8) as u8;
    bytes[3] = length as u8;
    let at = append(&mut bytes, 4, 0x00, &LUMINANCE_DC.0, &LUMINANCE_DC.1);
    let at = append(&mut bytes, at, 0x10, &LUMINANCE_AC.0, &LUMINANCE_AC.1);
    let at = append(&mut bytes, at, 0x01, &CHROMINANCE_DC.0, &CHROMINANCE_DC.1);
    append(&mut bytes, at, 0x11, &CHROMINANCE_AC.0, &CHROMINANCE_AC.1);
    bytes
}

const fn append(
    to: &mut [u8; LENGTH],
    mut at: usize,
    kind: u8,
    counts: &[u8; 16],
    values: &[u8],
) -> usize {
    to[at] = kind;
    at += 1;
    let mut i = 0;
    while i < 16 {
        to[at] = counts[i];
        (at, i) = (at + 1, i + 1);
    }
    i = 0;
    while i < values.len() {
        to[at] = values[i];
        (at, i) = (at + 1, i + 1);
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::rgb_from_file;

    /// A picture whose encoder uses the tables of annex K.
    fn picture() -> Vec<u8> {
        let pixels: Vec<u8> = (0..48 * 32)
            .flat_map(|p: u32| [(p % 48 * 5) as u8, (p / 48 * 7) as u8, (p * 11 % 251) as u8])
            .collect();
        let mut file = Vec::new();
        jpeg_encoder::Encoder::new(&mut file, 90)
            .encode(&pixels, 48, 32, jpeg_encoder::ColorType::Rgb)
            .unwrap();
        file
    }

    /// The same without its tables, as cameras give it.
    fn without_tables(file: &[u8]) -> Vec<u8> {
        let mut kept = file[..2].to_vec();
        let mut at = 2;
        while file[at + 1] != 0xda {
            let length = 2 + usize::from(u16::from_be_bytes([file[at + 2], file[at + 3]]));
            if file[at + 1] != 0xc4 {
                kept.extend_from_slice(&file[at..at + length]);
            }
            at += length;
        }
        kept.extend_from_slice(&file[at..]);
        kept
    }

    fn complete(frame: &[u8]) -> Vec<u8> {
        parts(frame, &inspect(frame).unwrap()).concat()
    }

    #[test]
    fn a_frame_without_tables_decodes_to_the_same_pixels() {
        let whole = picture();
        let bare = without_tables(&whole);
        assert!(bare.len() + 400 < whole.len());
        assert!(rgb_from_file("jpeg", &bare, (48, 32)).is_err());
        let expected = rgb_from_file("jpeg", &whole, (48, 32)).unwrap();
        assert_eq!(
            rgb_from_file("jpeg", &complete(&bare), (48, 32)).unwrap(),
            expected
        );
    }

    #[test]
    fn a_complete_frame_stays_as_it_is_but_for_what_is_behind_its_end() {
        let whole = picture();
        assert_eq!(complete(&whole), whole);
        let mut filled = whole.clone();
        filled.extend_from_slice(&[0; 1000]);
        assert_eq!(complete(&filled), whole);
    }

    #[test]
    fn the_tables_are_prefix_codes_that_use_no_more_than_there_is() {
        for counts in [
            LUMINANCE_DC.0,
            CHROMINANCE_DC.0,
            LUMINANCE_AC.0,
            CHROMINANCE_AC.0,
        ] {
            // Kraft: the sum of 2^-length is below 1, as T.81 leaves out the code of all ones.
            let used: u32 = (0..16).map(|i| u32::from(counts[i]) << (15 - i)).sum();
            assert!(used < 1 << 16, "{counts:?}");
        }
    }

    #[test]
    fn what_is_cut_off_is_never_whole() {
        let whole = picture();
        for length in 0..whole.len() {
            assert!(
                inspect(&whole[..length]).is_err(),
                "{length} of {}",
                whole.len()
            );
        }
        assert!(inspect(b"GIF89a").unwrap_err().contains("begin"));
    }

    proptest::proptest! {
        #[test]
        fn no_bytes_make_it_stumble(bytes in proptest::collection::vec(0_u8.., 0..300)) {
            let mut frame = vec![0xff, 0xd8];
            frame.extend(bytes);
            if let Ok(jpeg) = inspect(&frame) {
                let _ = parts(&frame, &jpeg).concat();
            }
        }
    }
}
