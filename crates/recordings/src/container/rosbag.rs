//! The SQLite files of rosbag2: a table of topics and one of messages.

use super::{
    Container, Defects, LARGEST, Message, MessageLocation, MessageTimes, Topic, Visitor,
    decompressed,
};
use lsdc_files::error::{Error, Result};
use rusqlite::limits::Limit;
use rusqlite::{Connection, OpenFlags};
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// An SQLite file.
pub(crate) struct Rosbag {
    path: PathBuf,
    database: Connection,
    topics: HashMap<i64, Arc<Topic>>,
    /// How the file is shorter than its header states, if it is.
    truncated: Option<String>,
}

impl Rosbag {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let truncated = missing_pages(path)?;
        let database = connect(path, truncated.is_some())?;
        let mut found = Self {
            path: path.to_owned(),
            database,
            topics: HashMap::new(),
            truncated,
        };
        found.topics = found.read_topics()?;
        Ok(found)
    }

    fn damaged(&self, cause: rusqlite::Error) -> Error {
        Error::format(&self.path, "cannot be read as a bag").because(cause)
    }

    /// Whether a table exists; views are excluded, since they could compute anything.
    fn has_table(&self, name: &str) -> Result<bool> {
        let query = "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = ?1";
        let count = self.database.query_row(query, [name], |row| row.get(0));
        count
            .map(|count: i64| count > 0)
            .map_err(|e| self.damaged(e))
    }

    fn read_topics(&self) -> Result<HashMap<i64, Arc<Topic>>> {
        if !self.has_table("topics")? || !self.has_table("messages")? {
            return Err(Error::format(
                &self.path,
                "is a database of SQLite, but no bag of ROS 2",
            ));
        }
        let mut definitions: HashMap<String, (String, String)> = HashMap::new();
        if self.has_table("message_definitions")? {
            let query =
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions";
            let found = self.rows(query, |row| Ok((row.get(0)?, (row.get(1)?, row.get(2)?))))?;
            definitions = HashMap::from_iter(found);
        }
        let plain = "SELECT id, name, type, serialization_format FROM topics";
        // Bags of the first versions lack the quality of service.
        let full = "SELECT id, name, type, serialization_format, offered_qos_profiles FROM topics";
        let known = self.database.prepare(full).is_ok();
        let topics = self.rows(if known { full } else { plain }, |row| {
            let kind: String = row.get(2)?;
            let definition = definitions.get(&kind);
            let quality = if known { row.get(4)? } else { String::new() };
            let topic = Topic {
                name: row.get(1)?,
                encoding: row.get(3)?,
                definition: definition
                    .map(|(language, text)| (language.clone(), text.clone().into_bytes())),
                kind,
                metadata: BTreeMap::from([("offered_qos_profiles".to_owned(), quality)]),
            };
            Ok((row.get(0)?, Arc::new(topic)))
        })?;
        Ok(HashMap::from_iter(topics))
    }

    /// Returns all readable rows of a small table.
    fn rows<T>(
        &self,
        query: &str,
        mut read: impl FnMut(&rusqlite::Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Vec<T>> {
        let mut statement = self.database.prepare(query).map_err(|e| self.damaged(e))?;
        let mut rows = statement.query([]).map_err(|e| self.damaged(e))?;
        let mut found = Vec::new();
        loop {
            match rows.next() {
                Ok(Some(row)) => found.extend(read(row)),
                Ok(None) => return Ok(found),
                Err(_) if self.truncated.is_some() => return Ok(found),
                Err(e) => return Err(self.damaged(e)),
            }
        }
    }
}

impl Container for Rosbag {
    fn topics(&self) -> Vec<Arc<Topic>> {
        self.topics.values().cloned().collect()
    }

    fn visit(
        &mut self,
        file: usize,
        is_selected: &dyn Fn(&Topic) -> bool,
        each: &mut Visitor<'_>,
    ) -> Result<Defects> {
        let mut defects = Defects {
            truncated: self.truncated.clone(),
            ..Defects::default()
        };
        let known = self.topics.iter().filter(|(_, topic)| is_selected(topic));
        let known: Vec<String> = known.map(|(id, _)| id.to_string()).collect();
        let query = format!(
            "SELECT id, topic_id, timestamp, data FROM messages WHERE topic_id IN ({}) ORDER BY id",
            known.join(", ")
        );
        let mut statement = self.database.prepare(&query).map_err(|e| self.damaged(e))?;
        let mut rows = statement.query([]).map_err(|e| self.damaged(e))?;
        let mut last = 0;
        loop {
            let row = match rows.next() {
                Ok(Some(row)) => row,
                Ok(None) => return Ok(defects),
                // The missing pages: the file ends here.
                Err(_) if defects.truncated.is_some() => return Ok(defects),
                Err(e) => {
                    defects
                        .add_damage(format!("the messages after row {last} cannot be read: {e}"));
                    return Ok(defects);
                }
            };
            let [id, topic, stamp] = [0_usize, 1, 2].map(|column| row.get::<_, i64>(column));
            let (Ok(id), Ok(topic), Ok(stamp), Ok(data)) = (id, topic, stamp, row.get_ref(3))
            else {
                defects.add_damage(format!("the row after {last} is no message"));
                continue;
            };
            last = id;
            let (Some(topic), Ok(data)) = (self.topics.get(&topic), data.as_blob()) else {
                defects.add_damage(format!("row {id} is no message"));
                continue;
            };
            let data = match decompressed(data) {
                Ok(data) => data,
                Err(what) => {
                    defects.add_damage(format!("the message of row {id} {what}"));
                    continue;
                }
            };
            let stamp = u64::try_from(stamp).unwrap_or(0);
            let message = Message {
                location: MessageLocation {
                    file,
                    at: id as u64,
                    within: 0,
                },
                times: MessageTimes {
                    log: stamp,
                    publish: stamp,
                },
                sequence: 0,
                data: &data,
            };
            each(topic, &message)?;
        }
    }

    fn read(&mut self, location: MessageLocation) -> Result<Vec<u8>> {
        let query = "SELECT data FROM messages WHERE id = ?1";
        let mut statement = self.database.prepare(query).map_err(|e| self.damaged(e))?;
        let data = statement.query_row([location.at as i64], |row| row.get::<_, Vec<u8>>(0));
        let data = data.map_err(|e| self.damaged(e))?;
        let found = decompressed(&data).map_err(|what| {
            Error::format(
                &self.path,
                format!("the message of row {} {what}", location.at),
            )
        })?;
        Ok(found.into_owned())
    }
}

/// Opens a possibly damaged or malicious database, read-only.
fn connect(path: &Path, is_cut: bool) -> Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let open = || {
        let database = Connection::open_with_flags(path, flags)?;
        database.set_limit(Limit::SQLITE_LIMIT_LENGTH, LARGEST as i32 - 1)?;
        // Otherwise SQLite rejects a database that is shorter than its header states.
        database.pragma_update(None, "writable_schema", is_cut)?;
        // Rows are read one by one, so that a small cache suffices.
        database.pragma_update(None, "cache_size", -4096)?;
        database.pragma_update(None, "mmap_size", 0)?;
        database.pragma_update(None, "trusted_schema", false)?;
        database.pragma_update(None, "cell_size_check", true)?;
        Ok(database)
    };
    open().map_err(|e: rusqlite::Error| Error::format(path, "cannot be opened as a bag").because(e))
}

/// Describes by how much a file is shorter than its header states, if it is.
fn missing_pages(path: &Path) -> Result<Option<String>> {
    let read = || {
        let mut file = File::open(path)?;
        let mut head = [0; 32];
        file.read_exact(&mut head)?;
        Ok((head, file.metadata()?.len()))
    };
    let (head, size) = read().map_err(|e| Error::read(path, e))?;
    let page = match u64::from(u16::from_be_bytes([head[16], head[17]])) {
        1 => 1 << 16,
        page => page,
    };
    let pages = u64::from(u32::from_be_bytes([head[28], head[29], head[30], head[31]]));
    let missing = (page * pages).saturating_sub(size);
    Ok((missing > 0).then(|| format!("the last {missing} bytes of the database are missing")))
}
