//! The names under which browsers reach the page. A request with another `Host` is refused, so that a foreign name that
//! was made to resolve to this computer reaches nothing.

/// One way to reach the page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Origin {
    /// As a browser sends it in `Origin`: `https://rig.example`.
    pub(super) text: String,
    /// As a browser sends it in `Host`: `rig.example`.
    pub(super) authority: String,
    /// Whether it is reached with TLS.
    pub(super) tls: bool,
}

/// All ways to reach the page; at least one.
#[derive(Clone, Debug)]
pub(super) struct Origins(Vec<Origin>);

impl Origins {
    /// Reads origins. Refuses what is not an origin, and one of the network without TLS; the error says why.
    pub(super) fn parse(texts: &[String]) -> Result<Self, String> {
        let origins: Result<Vec<_>, _> = texts.iter().map(|text| parse(text)).collect();
        Ok(Self(origins?))
    }

    /// The origin that a `Host` header names.
    pub(super) fn of_host(&self, host: &str) -> Option<&Origin> {
        let mut origins = self.0.iter();
        origins.find(|origin| origin.authority.eq_ignore_ascii_case(host))
    }

    /// The origin that a link for people names: one with TLS if there is one, for that is how others reach the page.
    pub(super) fn for_links(&self) -> Option<&Origin> {
        let with_tls = self.0.iter().find(|origin| origin.tls);
        with_tls.or_else(|| self.0.first())
    }
}

fn parse(text: &str) -> Result<Origin, String> {
    let wrong =
        || format!("found {text:?}, expected a scheme and a host, such as https://rig.example");
    let (scheme, authority) = text.split_once("://").ok_or_else(wrong)?;
    let tls = match scheme {
        "https" => true,
        "http" => false,
        _ => return Err(wrong()),
    };
    let is_fine = |c: char| c.is_ascii_alphanumeric() || ".-:[]".contains(c);
    if authority.is_empty() || !authority.chars().all(is_fine) {
        return Err(wrong());
    }
    // Browsers leave the scheme's own port out.
    let default = if tls { "443" } else { "80" };
    let (host, authority) = match authority.rsplit_once(':') {
        Some((host, port)) if port == default => (host, host),
        Some((host, port)) if !port.is_empty() && port.bytes().all(|b| b.is_ascii_digit()) => {
            (host, authority)
        }
        Some((_, "")) => return Err(wrong()),
        _ => (authority, authority),
    };
    if host.is_empty() {
        return Err(wrong());
    }
    if !tls && !["localhost", "127.0.0.1", "[::1]"].contains(&host) {
        return Err(format!(
            "{text:?} has no TLS: expected https, or http with localhost, 127.0.0.1 or [::1]"
        ));
    }
    Ok(Origin {
        text: format!("{scheme}://{authority}").to_ascii_lowercase(),
        authority: authority.to_ascii_lowercase(),
        tls,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_port_of_the_scheme_is_left_out_as_browsers_leave_it_out() {
        for (given, text, authority) in [
            (
                "https://Rig.example:443",
                "https://rig.example",
                "rig.example",
            ),
            ("http://localhost:80", "http://localhost", "localhost"),
            ("https://[fe80::1]:443", "https://[fe80::1]", "[fe80::1]"),
            (
                "https://rig.example:80",
                "https://rig.example:80",
                "rig.example:80",
            ),
            ("http://[::1]", "http://[::1]", "[::1]"),
        ] {
            let origin = parse(given).unwrap();
            let found = (origin.text.as_str(), origin.authority.as_str());
            assert_eq!(found, (text, authority), "{given}");
        }
        for refused in [
            "https://rig.example:",
            "https://:443",
            "http://rig.example:80",
        ] {
            parse(refused).unwrap_err();
        }
    }
}
