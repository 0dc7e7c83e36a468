//! Credentials of an operator: a server that trusts signed users, whose `.creds` files hold a token and a seed. They
//! work for a rig and a worker, and no seed is where somebody else could read it.

use crate::test_bench::{TestBench, models, said, simulated};
use nkeys::KeyPair;
use serde_json::{Value, json};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

/// Bytes in base64 for addresses, without padding (RFC 4648, section 5).
fn base64_url(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_";
    let of_three = |three: &[u8]| {
        let bits = (0..3).fold(0, |bits, i| {
            bits << 8 | usize::from(*three.get(i).unwrap_or(&0))
        });
        let digits = (0..=three.len()).map(|i| char::from(DIGITS[bits >> (18 - 6 * i) & 63]));
        digits.collect::<String>()
    };
    bytes.chunks(3).map(of_three).collect()
}

/// A token in which `issuer` says what `subject` is, as NATS defines it (version 2).
fn token(issuer: &KeyPair, subject: &KeyPair, what: &Value) -> String {
    let head = json!({ "typ": "JWT", "alg": "ed25519-nkey" });
    let claims = json!({
        "jti": "scand", "iat": 1_700_000_000, "iss": issuer.public_key(), "name": "scand",
        "sub": subject.public_key(), "nats": what,
    });
    let signed = [head, claims].map(|part| base64_url(part.to_string().as_bytes()));
    let signed = signed.join(".");
    let signature = issuer.sign(signed.as_bytes()).unwrap();
    format!("{signed}.{}", base64_url(&signature))
}

/// A user of the account, in a `.creds` file; gives the user's seed.
fn user(account: &KeyPair, path: &Path) -> String {
    let user = KeyPair::new_user();
    let what = json!({ "type": "user", "version": 2, "subs": -1, "data": -1, "payload": -1 });
    let (token, seed) = (token(account, &user, &what), user.seed().unwrap());
    let text = format!(
        "-----BEGIN NATS USER JWT-----\n{token}\n------END NATS USER JWT------\n\n\
         -----BEGIN USER NKEY SEED-----\n{seed}\n------END USER NKEY SEED------\n"
    );
    std::fs::write(path, text).unwrap();
    std::fs::set_permissions(path, PermissionsExt::from_mode(0o600)).unwrap();
    seed
}

#[test]
fn an_operators_credentials_work_for_rig_and_worker_and_their_seeds_stay_in_their_files() {
    let operator = KeyPair::new_operator();
    // A server with storage wants an account for itself, too.
    let [account, system] = [KeyPair::new_account(), KeyPair::new_account()];
    let limits = json!({
        "subs": -1, "data": -1, "payload": -1, "imports": -1, "exports": -1, "wildcards": true,
        "conn": -1, "leaf": -1, "mem_storage": -1, "disk_storage": -1, "streams": -1, "consumer": -1,
    });
    let of_operator = json!({ "type": "operator", "version": 2 });
    let of_account = json!({ "type": "account", "version": 2, "limits": limits });
    let of_system = json!({ "type": "account", "version": 2 });
    let configuration = format!(
        "operator: {}\nsystem_account: {system}\nresolver: MEMORY\nresolver_preload: {{ {}: {}, {system}: {} }}\n",
        token(&operator, &operator, &of_operator),
        account.public_key(),
        token(&operator, &account, &of_account),
        token(&operator, &system, &of_system),
        system = system.public_key(),
    );
    let Some(bench) = TestBench::start(&configuration) else {
        return;
    };
    let files = ["rig.creds", "worker.creds"].map(|name| bench.path(name));
    let seeds = files.each_ref().map(|path| user(&account, path));
    let recording = bench.path("fleet-6.mcap");
    std::fs::copy(simulated(6), &recording).unwrap();
    let [of_rig, of_worker] = files.each_ref().map(|path| path.to_str().unwrap());

    let _worker = bench.worker("attic", &["--credentials", of_worker]);
    let mut replay = bench.by_fleet(&recording, "out", &["--credentials", of_rig]);
    let output = replay.output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    assert_eq!(models(&bench.path("out")).len(), 6);

    let mut looked = 0;
    let mut folders = vec![bench.path("")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if !files.contains(&path) {
                let bytes = std::fs::read(&path).unwrap();
                looked += 1;
                for seed in &seeds {
                    let has_seed = bytes
                        .windows(seed.len())
                        .any(|part| part == seed.as_bytes());
                    assert!(!has_seed, "{}", path.display());
                }
            }
        }
    }
    assert!(looked > 20, "{looked}");
    let said_by_server = bench.log("server");
    assert!(
        !said_by_server.contains("uthorization Violation"),
        "{said_by_server}"
    );
}
