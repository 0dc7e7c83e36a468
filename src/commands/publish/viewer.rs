//! Holds the viewer's script, which is built with the operator's page, and the message of a build that does not have
//! it.

/// Why there is no viewer, and where one is.
pub(super) const MISSING: &str = "the pages have pictures and files, but no viewer, which this build of scand does not \
     have: install the Debian package that `make deb` makes (docs/installing.md), or run `make ui` and build with `cargo \
     build --release --features page`";

cfg_if::cfg_if! {
    if #[cfg(feature = "page")] {
        use crate::page::embedded;
    } else {
        fn embedded(_name: &str) -> Option<&'static [u8]> {
            None
        }
    }
}

/// The script; `None` if the program was built without it.
pub(super) fn script() -> Option<&'static [u8]> {
    embedded("publish/viewer.js")
}

/// The licences of what is in the script.
pub(super) fn licences() -> Option<&'static [u8]> {
    script().and(embedded("licences.txt"))
}
