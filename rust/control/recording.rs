//! A recording of the loop: plain MCAP, one JSON message per period, readable to the last second
//! after a power cut.
//!
//! Topic `/setup`, once: the configuration of the loop. Topic `/loop`, once per period: all inputs
//! and outputs of the guard, so a recording replays bit for bit (numbers have full precision;
//! non-finite values are null, which the guard also rejects). There are no chunks and no
//! compression: a truncated file gives every message before the cut. Source of the format: MCAP,
//! Foxglove, https://mcap.dev/spec. Pinned by tests/robot/test_recording.py and
//! tests/robot/test_live.py.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use mcap::records::{MessageHeader, Record};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{McapError, WriteOptions, parse_record};
use serde::Serialize;
use serde_json::{Map, Value, json};
use softmap_servo::control::Entry;
use softmap_servo::guard::Request;

use super::period::{Period, name, sensed};
use crate::error::{Result, invalid};

/// Longest time until recorded data are on the disk, ns.
const SAFE: u64 = 500_000_000;
/// Most bytes of a recording that are read.
const MOST: u64 = 4 << 30;
/// Most bytes of a record, and bytes per read.
const LONGEST: usize = 1 << 24;
const AT_ONCE: usize = 1 << 16;

/// An open recording.
pub struct Recording {
    writer: mcap::Writer<BufWriter<File>>,
    file: File,
    channel: u16,
    count: u32,
    saved: u64,
    line: Vec<u8>,
    servos: usize,
}

impl Recording {
    /// Begin `path`, which must not exist; `setup` is the JSON document of the loop.
    pub fn begin(
        path: &Path,
        setup: &str,
        now: u64,
        servos: usize,
        commands: usize,
    ) -> Result<Recording> {
        let file = File::create_new(path).map_err(|fault| failed(path, &fault))?;
        let again = file.try_clone().map_err(|fault| failed(path, &fault))?;
        let options = WriteOptions::new()
            .use_chunks(false)
            .compression(None)
            .library("softmap");
        let begun = || -> mcap::McapResult<_> {
            let mut writer = options.create(BufWriter::new(file))?;
            let object = br#"{"type": "object"}"#;
            let schema = writer.add_schema("softmap.setup", "jsonschema", object)?;
            let told = writer.add_channel(schema, "/setup", "json", &Default::default())?;
            let schema = writer.add_schema(
                "softmap.loop",
                "jsonschema",
                schema_of(servos, commands).to_string().as_bytes(),
            )?;
            let channel = writer.add_channel(schema, "/loop", "json", &Default::default())?;
            writer.write_to_known_channel(&header(told, 0, now), setup.as_bytes())?;
            writer.flush()?;
            Ok((writer, channel))
        };
        let (writer, channel) = begun().map_err(|fault| failed(path, &cause(&fault)))?;
        Ok(Recording {
            writer,
            file: again,
            channel,
            count: 0,
            saved: now,
            line: vec![],
            servos,
        })
    }

    /// Add a period.
    pub fn add(&mut self, entry: &Entry, commands: usize) -> mcap::McapResult<()> {
        self.line.clear();
        let told = Told::of(entry, self.servos, commands);
        serde_json::to_writer(&mut self.line, &told).map_err(std::io::Error::from)?;
        self.count = self.count.wrapping_add(1);
        let header = header(self.channel, self.count, entry.now);
        self.writer.write_to_known_channel(&header, &self.line)?;
        if entry.now.saturating_sub(self.saved) >= SAFE {
            self.saved = entry.now;
            self.save()?;
        }
        Ok(())
    }

    fn save(&mut self) -> mcap::McapResult<()> {
        self.writer.flush()?;
        Ok(self.file.sync_data()?)
    }

    /// Close it with a summary.
    pub fn end(mut self) -> mcap::McapResult<()> {
        self.writer.finish()?;
        self.writer.into_inner().flush()?;
        Ok(self.file.sync_data()?)
    }
}

/// A message: its topic, its time (ns) and its bytes.
pub type Message = (String, u64, Vec<u8>);

/// A reader of a recording, also while it grows.
pub struct Reading {
    path: PathBuf,
    file: File,
    records: LinearReader,
    topics: HashMap<u16, String>,
    counts: HashMap<u16, u32>,
    ended: bool,
}

impl Reading {
    /// Begin to read `path`.
    pub fn open(path: &Path) -> Result<Reading> {
        let options = LinearReaderOptions::default()
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_validate_data_section_crc(true)
            .with_validate_summary_section_crc(true)
            .with_record_length_limit(LONGEST);
        Ok(Reading {
            file: File::open(path).map_err(|fault| failed(path, &fault))?,
            path: path.to_owned(),
            records: LinearReader::new_with_options(options),
            topics: HashMap::new(),
            counts: HashMap::new(),
            ended: false,
        })
    }

    /// Whether the writer has closed the file.
    pub fn ended(&self) -> bool {
        self.ended
    }

    /// Add to `found` the messages that are complete and new; an error if the bytes after them are
    /// damaged.
    pub fn more(&mut self, found: &mut Vec<Message>) -> Result<()> {
        let damaged = |fault: McapError| match fault {
            McapError::BadMagic => {
                "no recording of a control loop; give what `softmap` recorded".to_owned()
            }
            other => format!("damaged ({other}); record again"),
        };
        let fault = loop {
            if self.ended {
                return Ok(());
            }
            let event = match self.records.next_event() {
                None => return Ok(()),
                Some(Err(fault)) => break damaged(fault),
                Some(Ok(event)) => event,
            };
            match event {
                LinearReadEvent::ReadRequest(bytes) => {
                    let room = self.records.insert(bytes.max(AT_ONCE));
                    match self.file.read(room) {
                        // The file may grow, so the end of file is not an error.
                        Ok(0) => return Ok(()),
                        Ok(count) => self.records.notify_read(count),
                        Err(fault) => break fault.to_string(),
                    }
                }
                LinearReadEvent::Record { opcode: 0, .. } => {
                    break "damaged (a record of no kind); record again".to_owned();
                }
                LinearReadEvent::Record { opcode, data } => match parse_record(opcode, data) {
                    Err(fault) => break damaged(fault),
                    Ok(Record::Channel(channel)) => {
                        self.topics.insert(channel.id, channel.topic);
                    }
                    Ok(Record::Message { header, data }) => {
                        if let Some(topic) = self.topics.get(&header.channel_id) {
                            let number = header.sequence;
                            let before = self.counts.insert(header.channel_id, number);
                            if let Some(last) = before
                                && last.wrapping_add(1) != number
                            {
                                break format!(
                                    "damaged (after message {last} of {topic} comes {number}); \
                                    record again"
                                );
                            }
                            found.push((topic.clone(), header.log_time, data.into_owned()));
                        }
                    }
                    Ok(record) => self.ended |= matches!(record, Record::Footer(_)),
                },
            }
        };
        Err(failed(&self.path, &fault))
    }
}

/// The messages of a recording, up to a cut or damage.
pub fn read(path: &Path) -> Result<Vec<Message>> {
    let mut reading = Reading::open(path)?;
    let size = reading
        .file
        .metadata()
        .map_err(|fault| failed(path, &fault))?
        .len();
    if size > MOST {
        return Err(invalid(format!(
            "{}: {} MB; recordings of up to {} MB are read",
            path.display(),
            size >> 20,
            MOST >> 20
        )));
    }
    let mut found = vec![];
    // After a power cut, the bytes may be arbitrary.
    let _ = reading.more(&mut found);
    Ok(found)
}

/// Why a write failed: the text of the operating system, which the writer's error omits.
pub fn cause(fault: &McapError) -> String {
    match fault {
        McapError::Io(cause) => cause.to_string(),
        other => other.to_string(),
    }
}

fn failed(path: &Path, fault: &dyn std::fmt::Display) -> crate::Error {
    invalid(format!("{}: {fault}", path.display()))
}

fn header(channel_id: u16, sequence: u32, now: u64) -> MessageHeader {
    MessageHeader {
        channel_id,
        sequence,
        log_time: now,
        publish_time: now,
    }
}

fn schema_of(servos: usize, commands: usize) -> Value {
    let numbers = |count: usize| {
        json!({
            "type": ["array", "null"],
            "items": {"type": ["number", "null"]},
            "minItems": count,
            "maxItems": count,
        })
    };
    let (integer, text, flag) = (
        json!({"type": "integer"}),
        json!({"type": ["string", "null"]}),
        json!({"type": "boolean"}),
    );
    let forms = [
        (
            integer,
            "now sent late_ns took_ns overruns asked lost damaged unasked",
        ),
        (text, "state cause request denied bus"),
        (flag, "heard deadman emergency torque refused"),
        (
            numbers(servos),
            "target goal position clock current_mA temperature_C voltage_V",
        ),
        (numbers(servos), "hardware has_torque tripped"),
        (numbers(commands), "command"),
    ];
    let each = |(form, keys): (Value, &'static str)| {
        keys.split(' ')
            .map(move |key| (key.to_owned(), form.clone()))
    };
    let properties: Map<String, Value> = forms.into_iter().flat_map(each).collect();
    json!({"type": "object", "properties": properties})
}

/// All inputs and outputs of the guard in a period.
#[derive(Serialize)]
struct Told {
    now: u64,
    heard: bool,
    deadman: bool,
    request: Option<String>,
    sent: u64,
    late_ns: u64,
    took_ns: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    command: Option<Vec<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    target: Option<Vec<f64>>,
    clock: Vec<Option<u16>>,
    #[serde(flatten)]
    health: Option<Examined>,
    #[serde(flatten)]
    period: Period,
}

/// The health of the servos, read at a lower rate.
#[derive(Serialize)]
struct Examined {
    hardware: Vec<Option<u8>>,
    has_torque: Vec<Option<u8>>,
    tripped: Vec<Option<u8>>,
}

impl Told {
    fn of(entry: &Entry, servos: usize, commands: usize) -> Told {
        let orders = &entry.orders;
        let hardware = sensed(entry, servos, |said| Some(said.health?.hardware));
        let health = hardware.iter().any(Option::is_some).then(|| Examined {
            hardware,
            has_torque: sensed(entry, servos, |said| Some(u8::from(said.health?.torque))),
            tripped: sensed(entry, servos, |said| Some(u8::from(said.health?.tripped))),
        });
        Told {
            now: entry.now,
            heard: orders.heard,
            deadman: orders.deadman,
            request: orders.request.map(name),
            sent: orders.sent,
            late_ns: entry.late,
            took_ns: entry.took,
            command: orders.command.map(|command| command[..commands].to_vec()),
            target: entry.aimed.then(|| entry.targets[..servos].to_vec()),
            clock: sensed(entry, servos, |said| Some(said.clock)),
            health,
            period: Period::of(entry, servos),
        }
    }
}

/// The request by its name in a recording.
pub fn request(called: &str) -> Option<Request> {
    Request::ALL
        .into_iter()
        .find(|request| name(*request) == called)
}
