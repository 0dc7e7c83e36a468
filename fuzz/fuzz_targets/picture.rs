//! Any bytes as a picture file of 64 x 48 pixels. Nothing may panic, and what is read has that size.

#![no_main]

use libfuzzer_sys::fuzz_target;
use scand::image::{grey_from_file, rgb_from_file};

fuzz_target!(|bytes: &[u8]| {
    for format in ["jpeg", "png"] {
        if let Ok(picture) = rgb_from_file(format, bytes, (64, 48)) {
            assert_eq!((picture.width(), picture.height()), (64, 48));
        }
        let _grey = grey_from_file(format, bytes, (64, 48));
    }
});
