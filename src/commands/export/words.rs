//! The values of `scand export`'s options, and the message for a person who uses another value.

use crate::dataset::Kind;
use crate::export::{Compression, Format};
use crate::words::closest;

/// A format by its name.
pub(super) fn format(text: &str) -> Result<Format, String> {
    let word = text.trim_start_matches('.').to_lowercase();
    if let Some(format) = Format::ALL.into_iter().find(|f| f.name() == word) {
        return Ok(format);
    }
    let tip = match word.as_str() {
        "ply" => "model.ply is in the capture's folder already".into(),
        "gltf" | "vrm" => "glb is glTF in one file".into(),
        "usd" | "usda" | "usdc" => "usdz holds the scene as usda".into(),
        "fbx" | "dae" | "collada" | "blend" | "max" => {
            "most programs that read it read glb too".into()
        }
        "colmap" | "nerfstudio" | "openmvs" => format!("scand export RECORDING --dataset {word}"),
        _ => match closest(&word, Format::ALL.map(Format::name)) {
            Some(close) => format!("did you mean {close}?"),
            None => "scand export --help says what each is for".into(),
        },
    };
    Err(format!(
        "expected {}; {tip}",
        listed(&Format::ALL.map(Format::name))
    ))
}

/// A program that datasets are made for, by its name.
pub(super) fn kind(text: &str) -> Result<Kind, String> {
    let word = text.to_lowercase();
    if let Some(kind) = Kind::ALL.into_iter().find(|kind| kind.name() == word) {
        return Ok(kind);
    }
    let names = Kind::ALL.map(Kind::name);
    let tip = match (word.as_str(), closest(&word, names)) {
        (_, Some(close)) => format!("did you mean {close}?"),
        (
            "3dgs" | "gsplat" | "gaussian-splatting" | "glomap" | "metashape" | "realitycapture",
            _,
        ) => "that reads datasets for colmap".into(),
        ("instant-ngp" | "nerf" | "splatfacto", _) => "that reads datasets for nerfstudio".into(),
        _ => "most programs read datasets for colmap".into(),
    };
    Err(format!("expected {}; {tip}", listed(&names)))
}

/// A way to make a glTF smaller, by its name.
pub(super) fn compression(text: &str) -> Result<Compression, String> {
    match text.to_lowercase().as_str() {
        "quantization" | "quantisation" | "quantize" => Ok(Compression::Quantization),
        "meshopt" | "draco" => Err(
            "only a library in C++ makes it, and scand is built without C++: export with --compress \
             (quantization), or let gltfpack or gltf-transform compress the exported file"
                .into(),
        ),
        _ => Err("expected quantization, the only compression".into()),
    }
}

/// Why a format is not compressed.
pub(super) fn no_compression(format: Format) -> String {
    let why = match format {
        Format::ThreeMf => "a 3MF package is always compressed",
        Format::Usdz => "a USDZ package must not be compressed",
        _ => "the format has no compression",
    };
    format!(
        "--compress is for --format glb, not for {}: {why}",
        format.name()
    )
}

/// Words in a row: `a, b or c`.
pub(super) fn listed(words: &[&str]) -> String {
    match words {
        [] => String::new(),
        [one] => (*one).into(),
        [first @ .., last] => format!("{} or {last}", first.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_word_gets_a_tip() {
        assert_eq!(format(".STL"), Ok(Format::Stl));
        for (word, tip) in [
            ("sdl", "did you mean stl?"),
            ("gltf", "glb is glTF"),
            ("ply", "model.ply"),
            ("colmap", "--dataset colmap"),
            ("docx", "obj, stl, 3mf, usdz or glb"),
        ] {
            let told = format(word).unwrap_err();
            assert!(told.contains(tip), "{word}: {told}");
        }
        assert!(kind("colmpa").unwrap_err().contains("did you mean colmap?"));
        assert!(kind("3dgs").unwrap_err().contains("colmap"));
        assert!(compression("draco").unwrap_err().contains("C++"));
    }
}
