//! `lsdc serve`: completion over HTTP.

use super::args::{Model, PretrainedEncoder, Serve};
use super::network::{name_of_own_guide, open_guided_completer, own_guide, with_encoder_side};
use super::{Exit, ui};
use lsdc_files::error::{Cause, Error, Result};
use lsdc_serve::{Access, Config, LogEntry, Server, Tls};
use lsdc_weights::weights_name;
use std::net::SocketAddr;
use std::sync::Arc;

/// Environment variable of the token. There is no option for it, because command lines are visible to all users.
const TOKEN: &str = "LSDC_TOKEN";

pub(super) fn run(args: &Serve) -> Result<Exit> {
    let tls = args.tls_cert.clone().zip(args.tls_key.clone());
    let tls = tls.map(|(certificate, key)| Tls { certificate, key });
    let config = Config {
        limits: args.limits.apply(),
        access: Access {
            token: token(args)?,
            open: args.without_token,
        },
        log: Some(Arc::new(log)),
        tls,
        ..Config::default()
    };
    let scheme = if config.tls.is_some() {
        "https"
    } else {
        "http"
    };
    let in_clear = config.access.token.is_some() && config.tls.is_none();
    let server = bind(&args.model, &args.encoder, args.listen, config)?;
    let address = server.address();
    if in_clear && !address.ip().is_loopback() {
        ui::say("the token goes over the network as it is; give --tls-cert and --tls-key");
    }
    ui::print(&format!("listening {scheme}://{address}"));
    serve(server)
}

/// A service with the weights and the device of the command line.
pub(super) fn bind(
    model: &Model,
    encoder: &PretrainedEncoder,
    address: SocketAddr,
    config: Config,
) -> Result<Server> {
    let weights = model.weights.as_deref();
    let guide = encoder.guide.as_ref();
    let completer = open_guided_completer(weights, &model.device, guide)?;
    let completer = with_encoder_side(completer, encoder.input.side)?;
    let mut name = weights_name(weights)?;
    if completer.has_depth_head()
        && let Some(own) = own_guide(weights, &model.device, guide)?
    {
        name = format!("{name}, guided by the {}", name_of_own_guide(&own));
    }
    let config = Config {
        weights: name,
        ..config
    };
    Server::bind(completer, address, config).map_err(failed)
}

/// Serves until Ctrl-C or a signal to end.
pub(super) fn serve(server: Server) -> Result<Exit> {
    let handle = server.handle();
    ui::on_stop(move || handle.end());
    server.run().map_err(failed)?;
    Ok(Exit::Done)
}

/// An error of the service as one of the program.
pub(super) fn failed(error: lsdc_serve::Error) -> Error {
    use lsdc_serve::Error as Serving;
    let cause = match error {
        Serving::Listen { .. } | Serving::Threads(_) | Serving::Random => Cause::Network,
        Serving::Certificate { .. } => Cause::Read,
        _ => Cause::Config,
    };
    let mut found = Error::new(cause, error.to_string());
    if let Some(source) = std::error::Error::source(&error) {
        found = found.because(source.to_string());
    }
    if let Some(hint) = error.hint() {
        found = found.hint(hint);
    }
    found
}

fn token(args: &Serve) -> Result<Option<String>> {
    let text = match &args.token_file {
        Some(path) => std::fs::read_to_string(path).map_err(|e| Error::read(path, e))?,
        None => match std::env::var(TOKEN) {
            Ok(_) if args.without_token => {
                let what = format!("`--without-token` and {TOKEN} contradict each other");
                return Err(Error::config(what));
            }
            Ok(token) => token,
            Err(_) => return Ok(None),
        },
    };
    Ok(Some(text.trim().to_owned()))
}

/// One line of JSON for each request.
fn log(entry: &LogEntry) {
    if let Ok(line) = serde_json::to_string(entry) {
        ui::say(&line);
    }
}
