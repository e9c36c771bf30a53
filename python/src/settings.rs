//! Settings of the fit from JSON with differences from the defaults.

use lsdc_core::settings::{FitConfig, Loss, Robust};
use serde_json::Value;

/// Returns settings with some of them changed, at any depth.
pub(crate) fn changed(config: FitConfig, changes: &str) -> Result<FitConfig, String> {
    let plain = |error: serde_json::Error| error.to_string();
    let mut config = serde_json::to_value(config).map_err(plain)?;
    let mut changes: Value = serde_json::from_str(changes).map_err(plain)?;
    // Not merged, because each loss has its own defaults.
    if let Some(value) = changes.as_object_mut().and_then(|all| all.remove("robust")) {
        config["robust"] = serde_json::to_value(robust(value)?).map_err(plain)?;
    }
    merge(&mut config, changes);
    serde_json::from_value(config).map_err(plain)
}

/// Reads robust settings: null, the name of a loss, or differences from the defaults of a loss.
pub(crate) fn robust(changes: Value) -> Result<Option<Robust>, String> {
    let loss = match &changes {
        Value::Null => return Ok(None),
        Value::Object(settings) => match settings.get("loss") {
            None | Some(Value::Null) => Loss::default(),
            Some(name) => loss(name)?,
        },
        name if name == NO_LOSS => return Ok(None),
        name => loss(name)?,
    };
    let plain = |error: serde_json::Error| error.to_string();
    let mut config = serde_json::to_value(Robust::new(loss)).map_err(plain)?;
    if changes.is_object() {
        merge(&mut config, changes);
    }
    serde_json::from_value(config).map(Some).map_err(plain)
}

/// Name of a plain fit, as on the command line.
const NO_LOSS: &str = "none";

/// Returns a loss by name.
fn loss(name: &Value) -> Result<Loss, String> {
    let mut all = Loss::ALL.into_iter();
    all.find(|loss| name == loss.name()).ok_or_else(|| {
        let losses = Loss::ALL.map(Loss::name).join(", ");
        format!("{name} is not a robust loss; losses: {NO_LOSS}, {losses}")
    })
}

fn merge(settings: &mut Value, changes: Value) {
    match (settings, changes) {
        (Value::Object(settings), Value::Object(changes)) => {
            for (name, change) in changes {
                merge(settings.entry(name).or_insert(Value::Null), change);
            }
        }
        (setting, change) => *setting = change,
    }
}
