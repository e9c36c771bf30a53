//! Keys of configurations that have new names. The old ones are understood, and said.

use toml::{Table, Value};

/// Old and new keys; those of `fit` are below it or, in settings of a fit alone, at the top.
const KEYS: [(&str, &str); 4] = [
    ("fit.joint.waves", "fit.joint.cosines"),
    ("joint.waves", "joint.cosines"),
    ("network.edges", "network.affinities"),
    ("train.loss.edges", "train.loss.affinities"),
];

/// Old and new values of keys.
const VALUES: [(&str, &str, &str); 3] = [
    ("fit.method", "wls", "field"),
    ("method", "wls", "field"),
    ("train.part", "edges", "affinities"),
];

/// Puts new names in the place of old ones, and returns a sentence for each.
pub fn renamed(table: &mut Table) -> Vec<String> {
    let mut said = Vec::new();
    for (old, new) in KEYS {
        let (Some((parent, old_key)), Some((_, new_key))) =
            (old.rsplit_once('.'), new.rsplit_once('.'))
        else {
            continue;
        };
        if let Some(table) = below(table, parent)
            && let Some(value) = table.remove(old_key)
        {
            table.insert(new_key.to_owned(), value);
            said.push(format!("`{old}` is called `{new}` now"));
        }
    }
    for (key, old, new) in VALUES {
        let (parent, key_alone) = key.rsplit_once('.').unwrap_or(("", key));
        if let Some(table) = below(table, parent)
            && let Some(value) = table.get_mut(key_alone)
            && value.as_str() == Some(old)
        {
            *value = Value::String(new.to_owned());
            said.push(format!("`{key} = \"{old}\"` is called \"{new}\" now"));
        }
    }
    said
}

fn below<'a>(table: &'a mut Table, path: &str) -> Option<&'a mut Table> {
    let mut parts = path.split('.').filter(|part| !part.is_empty());
    parts.try_fold(table, |table, part| table.get_mut(part)?.as_table_mut())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn old_keys_are_understood_and_said() {
        let text = "fit.joint.waves = 5.0\nfit.method = \"wls\"\nnetwork.edges = 16\ntrain.part = \"edges\"\n";
        let mut table: Table = toml::from_str(text).unwrap();
        assert_eq!(renamed(&mut table).len(), 4);
        let text = "fit.joint.cosines = 5.0\nfit.method = \"field\"\nnetwork.affinities = 16\n\
                    train.part = \"affinities\"\n";
        assert_eq!(table, toml::from_str(text).unwrap());
        assert!(renamed(&mut table).is_empty());
    }
}
