//! Encodes pictures and holds the style sheet for the calibration's page.

/// Bytes as text, for pictures that are part of the page (RFC 4648).
pub(super) fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let byte = |k: usize| u32::from(three.get(k).copied().unwrap_or(0));
        let bits = byte(0) << 16 | byte(1) << 8 | byte(2);
        for k in 0..4 {
            let letter = LETTERS[(bits >> (18 - 6 * k) & 63) as usize];
            text.push(if k <= three.len() {
                letter as char
            } else {
                '='
            });
        }
    }
    text
}

/// The page's style sheet.
pub(super) fn style() -> &'static str {
    "body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:70em;padding:0 1em;color:#222}\
     h1{font-size:1.7em}h2{font-size:1.2em;margin-top:1.8em;border-bottom:1px solid #ddd}\
     table{border-collapse:collapse;font-variant-numeric:tabular-nums}td,th{padding:.15em .7em;text-align:right;\
     border-bottom:1px solid #eee}td:first-child,th:first-child{text-align:left}\
     .good{color:#17702f}.fair{color:#7a6a00}.poor{color:#b35900}.bad{color:#c01616;font-weight:bold}\
     .figure{display:inline-block;margin:0 1.4em .4em 0}.figure b{font-size:1.3em}.missing{color:#555}\
     h3{font-size:1em;margin-bottom:.3em}.wide{overflow-x:auto}.words td,.words th{text-align:left}\
     .pictures{display:flex;flex-wrap:wrap;gap:1em}figure{margin:0}figcaption{font-size:.9em}\
     svg{background:#fafafa;border:1px solid #ccc}svg text{font:11px system-ui,sans-serif;fill:#222}"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_written_as_rfc_4648_has_them() {
        for (bytes, text) in [
            ("", ""),
            ("f", "Zg=="),
            ("go", "Z28="),
            ("foo", "Zm9v"),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
        assert_eq!(base64(&[0xff, 0xef, 0xbe]), "/+++");
    }
}
