//! `scand page`: serves the operator's page. Its subcommands ask a page that is running for links, tokens and the list
//! of its sessions.

use crate::page::{
    Answer, ControlRequest, DEFAULT_CONFIGURATION, Parameters, ParametersError, Role, ask,
    run as serve,
};
use anyhow::Context;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Serve the operator's page on this computer, until SIGTERM or Ctrl-C.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  scand page
  scand page pair
  scand page pair --role viewer
  scand page revoke --all")]
pub struct Args {
    /// The page's configuration; by default /etc/scand/page.toml, if it exists
    #[arg(short, long, value_name = "FILE.toml", global = true)]
    config: Option<PathBuf>,
    #[command(subcommand)]
    what: Option<PageAction>,
}

#[derive(Debug, clap::Subcommand)]
enum PageAction {
    /// Print a link that begins one session within ten minutes
    Pair {
        /// What the session may do
        #[arg(long, value_enum, default_value = "operator")]
        role: PairRole,
    },
    /// List the open sessions
    Sessions,
    /// End sessions
    #[command(group = clap::ArgGroup::new("which").required(true))]
    Revoke {
        /// The session, as `scand page sessions` names it
        #[arg(group = "which")]
        id: Option<String>,
        /// End all sessions, and all links that were not used yet
        #[arg(long, group = "which")]
        all: bool,
    },
    /// Print a token for /metrics, which is valid until it is revoked
    Token,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum PairRole {
    /// See everything, but change nothing
    Viewer,
    /// Look, press, take backgrounds, begin and close sessions, and note
    Operator,
}

/// Serves the page, or asks the one that is running.
///
/// # Errors
/// If the configuration is refused, the page cannot be served, or none is running.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let installed = Path::new(DEFAULT_CONFIGURATION);
    let config = args.config.as_deref();
    let config = config.or_else(|| installed.exists().then_some(installed));
    let parameters = Parameters::load(config).map_err(bad_configuration)?;
    let Some(what) = args.what else {
        serve(&parameters)?;
        return Ok(ExitCode::SUCCESS);
    };
    let asked = match what {
        PageAction::Pair { role } => ControlRequest::Pair {
            role: match role {
                PairRole::Viewer => Role::Viewer,
                PairRole::Operator => Role::Operator,
            },
        },
        PageAction::Sessions => ControlRequest::Sessions {},
        PageAction::Revoke { id, .. } => ControlRequest::Revoke { id },
        PageAction::Token => ControlRequest::Token {},
    };
    let answer = ask(&parameters.control, &asked).with_context(|| {
        let control = parameters.control.display();
        format!("{control}: is the page running (`systemctl start scand-page`, or `scand page`), and are you root or in the group scand?")
    })?;
    print(&answer)
}

fn bad_configuration(error: ParametersError) -> anyhow::Error {
    super::BadConfiguration(error.into()).into()
}

fn print(answer: &Answer) -> anyhow::Result<ExitCode> {
    match answer {
        Answer::Link { link } => {
            if let Ok(code) = qrcode::QrCode::new(link) {
                outln!(
                    "{}",
                    code.render::<qrcode::render::unicode::Dense1x2>().build()
                );
            }
            outln!(
                "{link}\nIt begins one session within ten minutes. Anybody who has this link can use it, so do not show it \
                 to others."
            );
        }
        Answer::Token { token } => outln!("{token}"),
        Answer::Sessions { sessions } => {
            for session in sessions {
                let role = format!("{:?}", session.role).to_lowercase();
                outln!("{}  {role:8}  {} h left", session.id, session.left_s / 3600);
            }
        }
        Answer::Revoked { sessions } => {
            outln!("{} ended", crate::words::count(*sessions, "session"));
        }
        Answer::Refused { reason } => anyhow::bail!("{reason}"),
    }
    Ok(ExitCode::SUCCESS)
}
