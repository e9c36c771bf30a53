//! Publishes every message of a topic under another name: `relay FROM TO TYPE [sensor|default|latched]`.
//!
//! `scripts/peers/dds.py` runs it between publishers and subscribers of other implementations.
#![allow(clippy::print_stdout, clippy::print_stderr)]

use std::{env, error::Error, thread, time::Duration};

use lsdc_dds::{Participant, Qos, Settings};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let (from, to, message_type, qos) = match &arguments[..] {
        [from, to, message_type] => (from, to, message_type, Qos::SENSOR_DATA),
        [from, to, message_type, qos] => {
            let qos = match qos.as_str() {
                "sensor" => Qos::SENSOR_DATA,
                "default" => Qos::DEFAULT,
                "latched" => Qos::LATCHED,
                other => {
                    return Err(format!("`{other}` is none of sensor, default, latched").into());
                }
            };
            (from, to, message_type, qos)
        }
        _ => return Err("usage: relay FROM TO TYPE [sensor|default|latched]".into()),
    };
    let (domain, settings) = Settings::from_environment()?;
    let participant = Participant::new(domain, settings)?;
    let publisher = participant.advertise(to, message_type, qos)?;
    let subscription = participant.subscribe(
        from,
        message_type,
        qos,
        Box::new(move |message| {
            if let Err(error) = publisher.publish(&message) {
                eprintln!("{error}");
            }
        }),
    )?;
    let mut last = None;
    loop {
        thread::sleep(Duration::from_secs(1));
        let status = subscription.status();
        if last.replace(status) != Some(status) {
            println!("{status:?} {:?}", participant.counts());
        }
    }
}
