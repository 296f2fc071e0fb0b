//! A recording of the loop: plain MCAP, a JSON message a period, that a cut of power leaves readable to its last second.
//!
//! Topic `/setup`, once: what the loop was made of. Topic `/loop`, a period: all that the guard was told and what it said,
//! so that a recording replays bit for bit (numbers are written in full; what is not finite is null, which the guard
//! refuses alike). No chunks and no compression: a file cut anywhere gives every message before the cut.
//! Source of the format: MCAP, Foxglove, https://mcap.dev/spec.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use enumset::EnumSet;
use mcap::WriteOptions;
use mcap::read::{Options, RawMessageStream};
use mcap::records::MessageHeader;
use softmap_servo::control::Entry;
use softmap_servo::guard::{MOST_SERVOS, Request};

use super::report::{list, name, quoted};
use crate::error::{Result, invalid};

/// ns after which what was recorded is on the disk.
const SAFE: u64 = 500_000_000;
/// Bytes of a recording that are read at most.
const MOST: u64 = 4 << 30;

/// An open recording.
pub struct Recording {
    writer: mcap::Writer<BufWriter<File>>,
    file: File,
    channel: u16,
    count: u32,
    saved: u64,
    line: String,
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
                schema_of(servos, commands).as_bytes(),
            )?;
            let channel = writer.add_channel(schema, "/loop", "json", &Default::default())?;
            writer.write_to_known_channel(&header(told, 0, now), setup.as_bytes())?;
            writer.flush()?;
            Ok((writer, channel))
        };
        let (writer, channel) = begun().map_err(|fault| failed(path, &fault))?;
        Ok(Recording {
            writer,
            file: again,
            channel,
            count: 0,
            saved: now,
            line: String::new(),
            servos,
        })
    }

    /// Add a period.
    pub fn add(&mut self, entry: &Entry, commands: usize) -> mcap::McapResult<()> {
        self.line.clear();
        document(&mut self.line, entry, self.servos, commands);
        self.count = self.count.wrapping_add(1);
        let header = header(self.channel, self.count, entry.now);
        self.writer
            .write_to_known_channel(&header, self.line.as_bytes())?;
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

/// The messages of a recording: topic, time (ns) and bytes; those before the cut of one that was cut short.
pub fn read(path: &Path) -> Result<Vec<(String, u64, Vec<u8>)>> {
    let size = std::fs::metadata(path)
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
    let bytes = std::fs::read(path).map_err(|fault| failed(path, &fault))?;
    let stream = RawMessageStream::new_with_options(&bytes, EnumSet::only(Options::IgnoreEndMagic));
    let mut stream = stream.map_err(|_| {
        invalid(format!(
            "{}: is no MCAP file; give a recording of softmap",
            path.display()
        ))
    })?;
    let mut found = vec![];
    while let Some(Ok(message)) = stream.next() {
        let Some(channel) = stream.get_channel(message.header.channel_id) else {
            break;
        };
        found.push((
            channel.topic.clone(),
            message.header.log_time,
            message.data.to_vec(),
        ));
    }
    Ok(found)
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

fn schema_of(servos: usize, commands: usize) -> String {
    let numbers = |count: usize| {
        format!(
            r#"{{"type": ["array", "null"], "items": {{"type": ["number", "null"]}}, "minItems": {count}, "maxItems": {count}}}"#
        )
    };
    let of = |keys: &[&str], form: &str| {
        keys.iter()
            .map(|key| format!(r#""{key}": {form}"#))
            .collect::<Vec<_>>()
            .join(", ")
    };
    format!(
        r#"{{"type": "object", "properties": {{{}, {}, {}, {}, {}, {}}}}}"#,
        of(
            &["now", "sent", "late_ns", "took_ns", "overruns"],
            r#"{"type": "integer"}"#
        ),
        of(
            &["state", "cause", "request", "denied", "bus"],
            r#"{"type": ["string", "null"]}"#
        ),
        of(
            &["heard", "deadman", "emergency", "torque", "refused"],
            r#"{"type": "boolean"}"#
        ),
        of(
            &[
                "target",
                "goal",
                "position",
                "clock",
                "current_mA",
                "temperature_C",
                "voltage_V"
            ],
            &numbers(servos)
        ),
        of(&["hardware", "has_torque", "tripped"], &numbers(servos)),
        of(&["command"], &numbers(commands)),
    )
}

fn document(line: &mut String, entry: &Entry, servos: usize, commands: usize) {
    let (orders, output) = (&entry.orders, &entry.output);
    // Writing to a String cannot fail.
    let _ = write!(
        line,
        r#"{{"now": {}, "heard": {}, "deadman": {}, "emergency": {}, "request": {}, "sent": {}, "state": "{}", "cause": "{}", "torque": {}, "refused": {}, "denied": {}, "bus": {}, "late_ns": {}, "took_ns": {}, "overruns": {}"#,
        entry.now,
        orders.heard,
        orders.deadman,
        orders.emergency,
        quoted(orders.request.map(name)),
        orders.sent,
        name(output.state),
        name(output.cause),
        output.torque,
        output.refused,
        quoted(output.denied.map(name)),
        quoted(entry.fault.map(|fault| fault.to_string())),
        entry.late,
        entry.took,
        entry.overruns,
    );
    if let Some(command) = &orders.command {
        list(line, "command", commands, &|k| Some(command[k]));
    }
    if entry.aimed {
        list(line, "target", servos, &|k| Some(entry.targets[k]));
    }
    list(line, "goal", servos, &|k| {
        output.torque.then(|| f64::from(entry.goals[k]))
    });
    let sensed = |k: usize| entry.feedback[k];
    list(line, "position", servos, &|k| {
        Some(f64::from(sensed(k)?.position))
    });
    list(line, "clock", servos, &|k| {
        Some(f64::from(sensed(k)?.clock))
    });
    list(line, "current_mA", servos, &|k| sensed(k)?.current);
    list(line, "temperature_C", servos, &|k| {
        Some(sensed(k)?.temperature)
    });
    list(line, "voltage_V", servos, &|k| Some(sensed(k)?.voltage));
    let health = |k: usize| sensed(k)?.health;
    if (0..servos.min(MOST_SERVOS)).any(|k| health(k).is_some()) {
        list(line, "hardware", servos, &|k| {
            Some(f64::from(health(k)?.hardware))
        });
        list(line, "has_torque", servos, &|k| {
            Some(f64::from(u8::from(health(k)?.torque)))
        });
        list(line, "tripped", servos, &|k| {
            Some(f64::from(u8::from(health(k)?.tripped)))
        });
    }
    line.push('}');
}

/// The request of its name in a recording.
pub fn request(called: &str) -> Option<Request> {
    Request::ALL
        .into_iter()
        .find(|request| name(*request) == called)
}
