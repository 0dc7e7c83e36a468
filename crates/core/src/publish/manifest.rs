//! Manifests of IIIF's Presentation API 3.0, the stable version when this was written. Version 4, a draft, has a
//! `Scene` for three dimensions; 3.0 knows the type `Model` and paints it on a canvas, which is what today's viewers
//! of models read. A second canvas has a picture, for viewers of pictures. `docs/formats.md` has the reasons.

use super::{LevelFile, Picture, PublishedObject};
use crate::markup::{escaped, without_markup};
use serde_json::{Value, json};

const CONTEXT: &str = "http://iiif.io/api/presentation/3/context.json";
/// Licences that the standard has a property for begin with one of these.
const LICENCES: [&str; 4] = [
    "http://creativecommons.org/",
    "https://creativecommons.org/",
    "http://rightsstatements.org/",
    "https://rightsstatements.org/",
];

/// The address at which a web server will have the folder: identifiers of manifests are complete addresses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address(String);

impl Address {
    /// Checks an address. One without `/` at its end gets it.
    ///
    /// # Errors
    /// If it is not an address of a folder by http or https, in words for the terminal.
    pub fn parse(text: &str) -> Result<Self, String> {
        let host = text
            .strip_prefix("https://")
            .or_else(|| text.strip_prefix("http://"));
        let is_letter = |c: char| c.is_ascii_alphanumeric() || "-._~:/%[]".contains(c);
        match host {
            Some(host)
                if host.starts_with(|c: char| c.is_ascii_alphanumeric() || c == '[')
                    && host.chars().all(is_letter) =>
            {
                Ok(Self(format!("{}/", text.trim_end_matches('/'))))
            }
            _ => Err("expected the address of a folder, such as https://museum.example/3d".into()),
        }
    }

    fn of(&self, object: &PublishedObject, name: &str) -> String {
        format!("{}objects/{}/{name}", self.0, object.id)
    }
}

/// The manifest of an object: a canvas with the model, one with a picture, and all files for download.
pub fn manifest(object: &PublishedObject, at: &Address) -> Value {
    let heading = without_markup(&object.heading());
    let mut manifest = json!({
        "@context": CONTEXT,
        "id": at.of(object, "manifest.json"),
        "type": "Manifest",
        "label": { "none": [heading] },
        "metadata": metadata(object),
        "thumbnail": [image(object, at, &object.thumbnail)],
        "homepage": [{
            "id": at.of(object, "index.html"), "type": "Text", "format": "text/html",
            "label": { "en": ["Page of the object"] },
        }],
        "rendering": object.levels.iter().map(|level| model(object, at, level)).collect::<Vec<_>>(),
        "seeAlso": [{
            "id": at.of(object, "scene.svx.json"), "type": "Dataset", "format": "application/json",
            "label": { "en": ["Scene for Smithsonian Voyager"] },
        }],
        "items": canvases(object, at),
    });
    if let Some(rights) = &object.about.rights {
        manifest["requiredStatement"] =
            json!({ "label": { "en": ["Rights"] }, "value": { "none": [value(rights)] } });
        let is_address = rights.chars().all(|c| c.is_ascii_graphic());
        if is_address && LICENCES.iter().any(|licence| rights.starts_with(licence)) {
            manifest["rights"] = rights.as_str().into();
        }
    }
    manifest
}

/// The manifests of all objects.
pub fn collection(objects: &[PublishedObject], title: &str, at: &Address) -> Value {
    let item = |object: &PublishedObject| {
        json!({
            "id": at.of(object, "manifest.json"),
            "type": "Manifest",
            "label": { "none": [without_markup(&object.heading())] },
            "thumbnail": [image(object, at, &object.thumbnail)],
        })
    };
    json!({
        "@context": CONTEXT,
        "id": format!("{}collection.json", at.0),
        "type": "Collection",
        "label": { "none": [without_markup(title)] },
        "items": objects.iter().map(item).collect::<Vec<_>>(),
    })
}

fn canvases(object: &PublishedObject, at: &Address) -> Vec<Value> {
    // What loads fast stands for the model; the others are offered beside it.
    let shown = object.levels.iter().find(|level| level.quality == "Medium");
    let shown = shown
        .or(object.levels.first())
        .map(|level| model(object, at, level));
    let picture = image(object, at, &object.picture);
    let bodies = [
        ("model", "The model", shown),
        ("picture", "A picture of the model", Some(picture)),
    ];
    let canvas = |(name, label, body): (&str, &str, Option<Value>)| {
        let id = at.of(object, &format!("canvas/{name}"));
        Some(json!({
            "id": id, "type": "Canvas", "label": { "en": [label] },
            "width": object.picture.size.0, "height": object.picture.size.1,
            "items": [{
                "id": format!("{id}/page"), "type": "AnnotationPage",
                "items": [{
                    "id": format!("{id}/annotation"), "type": "Annotation", "motivation": "painting",
                    "body": body?, "target": id,
                }],
            }],
        }))
    };
    bodies.into_iter().filter_map(canvas).collect()
}

fn model(object: &PublishedObject, at: &Address, level: &LevelFile) -> Value {
    json!({
        "id": at.of(object, &level.name), "type": "Model", "format": "model/gltf-binary",
        "label": { "en": [format!("Model, {} triangles", level.triangles)] },
    })
}

fn image(object: &PublishedObject, at: &Address, picture: &Picture) -> Value {
    json!({
        "id": at.of(object, &picture.name), "type": "Image", "format": "image/jpeg",
        "width": picture.size.0, "height": picture.size.1,
    })
}

fn metadata(object: &PublishedObject) -> Vec<Value> {
    let about = &object.about;
    let size = object.size_mm().map(|mm| format!("{mm:.0}")).join(" × ") + " mm";
    let verdict = object.facts.level.map(|level| level.name().to_owned());
    let pairs = [
        ("Number", about.subject.clone()),
        ("Title", about.title.clone()),
        ("Size", Some(size)),
        ("Verdict on the model", verdict),
        ("Captured", Some(about.time.clone())),
        ("Operator", about.operator.clone()),
        ("Project", about.project.clone()),
        ("Session", about.session.clone()),
        ("Rig", about.rig.clone()),
        ("Made by", Some(about.program.clone())),
    ];
    let pair = |(name, text): (&str, Option<String>)| {
        Some(json!({ "label": { "en": [name] }, "value": { "none": [value(&text?)] } }))
    };
    pairs.into_iter().filter_map(pair).collect()
}

/// A value, which viewers take for HTML if it begins with `<` and ends with `>`: such a text becomes HTML that shows
/// it.
fn value(text: &str) -> String {
    match text.contains(['<', '>']) {
        true => format!("<span>{}</span>", escaped(text)),
        false => without_markup(text),
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{HOSTILE, object};
    use super::*;

    fn at() -> Address {
        Address::parse("https://museum.example/3d").unwrap()
    }

    #[test]
    fn an_address_is_checked() {
        assert_eq!(at(), Address::parse("https://museum.example/3d/").unwrap());
        for bad in [
            "museum.example",
            "ftp://a",
            "https://",
            "https:///x",
            "https://a/?b",
            "https://a/\"b",
            "javascript:1",
        ] {
            assert!(Address::parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_manifest_paints_the_model_and_a_picture_and_offers_each_level() {
        let manifest = manifest(&object(), &at());
        let folder = "https://museum.example/3d/objects/1884-3-0123abcd/";
        assert_eq!(manifest["id"], format!("{folder}manifest.json"));
        let body = |i: usize| manifest["items"][i]["items"][0]["items"][0]["body"].clone();
        assert_eq!(body(0)["type"], "Model");
        assert_eq!(body(0)["id"], format!("{folder}medium.glb"));
        assert_eq!(body(1)["type"], "Image");
        assert_eq!(manifest["rendering"].as_array().unwrap().len(), 3);
        assert!(manifest.get("rights").is_none(), "CC0 is no address");
        let mut licensed = object();
        licensed.about.rights = Some("http://creativecommons.org/publicdomain/zero/1.0/".into());
        let licensed = super::manifest(&licensed, &at());
        assert_eq!(
            licensed["rights"],
            "http://creativecommons.org/publicdomain/zero/1.0/"
        );
        let collection = collection(&[object()], "All", &at());
        assert_eq!(collection["items"][0]["id"], manifest["id"]);
    }

    #[test]
    fn no_text_of_a_recording_is_markup_in_a_manifest() {
        let mut object = object();
        let about = &mut object.about;
        for text in [
            &mut about.subject,
            &mut about.title,
            &mut about.rights,
            &mut about.operator,
        ] {
            *text = Some(HOSTILE.into());
        }
        for text in [&mut about.time, &mut about.input_sha256, &mut about.program] {
            *text = HOSTILE.into();
        }
        for json in [
            manifest(&object, &at()),
            collection(&[object], HOSTILE, &at()),
        ] {
            let text = json
                .to_string()
                .replace("<span>", "")
                .replace("</span>", "");
            assert!(!text.contains('<') && text.contains("script"), "{text}");
        }
    }
}
