//! The page's own files, which `make ui` makes of `ui/` and the build puts into the program.

use flate2::Compression;
use flate2::write::GzEncoder;
use std::collections::BTreeMap;
use std::io::Write;

/// A file of the page.
pub(super) struct Asset {
    pub(super) media_type: &'static str,
    pub(super) plain: &'static [u8],
    pub(super) compressed: Vec<u8>,
    /// Whether its name changes with its content.
    pub(super) is_hashed: bool,
}

// `EMBEDDED`: the name of each file, such as `assets/index-1a2b.js`, and its bytes.
include!(concat!(env!("OUT_DIR"), "/page_files.rs"));

/// A file that `make ui` made, also one that the page does not serve; `None` if the program was built without it.
pub fn embedded(name: &str) -> Option<&'static [u8]> {
    let found = EMBEDDED.iter().find(|(known, _)| *known == name);
    found.map(|(_, bytes)| *bytes)
}

/// All files of the page by name; none if the program was built without them.
pub(super) fn assets() -> BTreeMap<&'static str, Asset> {
    let served = EMBEDDED
        .iter()
        .filter(|(name, _)| !name.starts_with("publish/"));
    let assets = served.map(|(name, bytes)| (*name, asset(name, bytes)));
    assets.collect()
}

fn asset(name: &str, plain: &'static [u8]) -> Asset {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    let written = encoder.write_all(plain).and_then(|()| encoder.finish());
    Asset {
        media_type: media_type(name),
        plain,
        // Writing into memory does not fail; if it did, the file would be sent as it is.
        compressed: written.unwrap_or_default(),
        is_hashed: name.starts_with("assets/"),
    }
}

fn media_type(name: &str) -> &'static str {
    match name.rsplit_once('.').map_or("", |(_, ending)| ending) {
        "html" => "text/html; charset=utf-8",
        "js" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "svg" => "image/svg+xml",
        "json" | "webmanifest" => "application/json",
        "txt" => "text/plain; charset=utf-8",
        "woff2" => "font/woff2",
        _ => "application/octet-stream",
    }
}
