//! The scene file of Smithsonian's Voyager (`scene.svx.json`, document version 1.0): one model with its levels of
//! detail. `docs/formats.md` says where it is from.

use super::{LevelFile, PublishedObject};
use crate::markup::without_markup;
use crate::output::y_up;
use serde_json::{Value, json};

/// The document. Its addresses are relative to its own place.
pub fn scene(object: &PublishedObject) -> Value {
    let heading = without_markup(&object.heading());
    let about = &object.about;
    let mut collection = json!({
        "title": heading,
        "titles": { "EN": heading },
    });
    for (name, text) in [("identifier", &about.subject), ("rights", &about.rights)] {
        if let Some(text) = text {
            collection[name] = without_markup(text).into();
        }
    }
    let mut asset = json!({
        "type": "application/si-dpo-3d.document+json",
        "version": "1.0",
        "generator": without_markup(&about.program),
    });
    if let Some(rights) = about.rights.as_deref().filter(|rights| !rights.is_empty()) {
        asset["copyright"] = without_markup(rights).into();
    }
    let (low, high) = corners(object);
    let pictures = [("Thumb", &object.thumbnail), ("High", &object.picture)];
    let images = pictures.map(|(quality, picture)| {
        json!({
            "uri": picture.name, "quality": quality, "usage": "Render", "byteSize": picture.bytes,
            "width": picture.size.0, "height": picture.size.1,
        })
    });
    json!({
        "asset": asset,
        "scene": 0,
        "scenes": [{ "name": heading, "units": "m", "nodes": [0], "setup": 0, "meta": 0 }],
        "nodes": [{ "name": "model", "model": 0 }],
        "setups": [{ "units": "mm" }],
        "metas": [{
            "collection": collection,
            "process": {
                "program": without_markup(&about.program),
                "captured": without_markup(&about.time),
                "inputSha256": without_markup(&about.input_sha256),
            },
            "images": images,
        }],
        "models": [{
            "units": "m",
            "boundingBox": { "min": low, "max": high },
            "derivatives": object.levels.iter().map(derivative).collect::<Vec<_>>(),
        }],
    })
}

fn derivative(level: &LevelFile) -> Value {
    json!({
        "usage": "Web3D",
        "quality": level.quality,
        "assets": [{
            "uri": level.name, "type": "Model", "mimeType": "model/gltf-binary",
            "byteSize": level.bytes, "numFaces": level.triangles,
        }],
    })
}

/// The box around the model in the file's frame, y up.
fn corners(object: &PublishedObject) -> ([f32; 3], [f32; 3]) {
    let turned = object.bounds.map(y_up);
    let extreme =
        |of: fn(f32, f32) -> f32| [0, 1, 2].map(|axis| of(turned[0][axis], turned[1][axis]));
    (extreme(f32::min), extreme(f32::max))
}

#[cfg(test)]
mod tests {
    use super::super::testing::{HOSTILE, object};
    use super::*;

    #[test]
    fn a_scene_has_the_model_at_each_level_in_metres_with_y_up() {
        let scene = scene(&object());
        let model = &scene["models"][0];
        assert_eq!(model["units"], "m");
        assert_eq!(
            model["boundingBox"]["min"],
            json!([-0.04_f32, 0.0_f32, -0.03_f32])
        );
        assert_eq!(
            model["boundingBox"]["max"],
            json!([0.04_f32, 0.1_f32, 0.03_f32])
        );
        let derivatives = model["derivatives"].as_array().unwrap();
        let qualities: Vec<&Value> = derivatives.iter().map(|d| &d["quality"]).collect();
        assert_eq!(qualities, ["High", "Medium", "Low"]);
        assert_eq!(derivatives[1]["assets"][0]["uri"], "medium.glb");
        assert_eq!(
            scene["asset"]["type"],
            "application/si-dpo-3d.document+json"
        );
    }

    #[test]
    fn no_text_of_a_recording_is_markup_in_a_scene() {
        let mut object = object();
        let about = &mut object.about;
        for text in [&mut about.subject, &mut about.title, &mut about.rights] {
            *text = Some(HOSTILE.into());
        }
        for text in [&mut about.time, &mut about.input_sha256, &mut about.program] {
            *text = HOSTILE.into();
        }
        let text = scene(&object).to_string();
        assert!(!text.contains('<') && text.contains("script"), "{text}");
    }
}
