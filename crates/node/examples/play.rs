//! Plays a recording in real time to a node in the same process. With a port, Foxglove can show the topics.
//!
//!     cargo run --release -p lsdc-node --features foxglove --example play -- drive.mcap [PORT [TIMES]]

#![allow(clippy::print_stdout, clippy::unwrap_used)]

use lsdc_core::{Completer, Weights};
use lsdc_node::{Clock as _, Foxglove, MemoryTransport, Node, NodeConfig, SystemClock};
use lsdc_recordings::{FrameOptions, Frames, Recording};
use std::error::Error;
use std::sync::Arc;
use std::time::Duration;

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let path = args.next().ok_or("give a recording")?;
    let port = args.next().map(|port| port.parse()).transpose()?;
    let times: u32 = args.next().map_or(Ok(1), |times| times.parse())?;
    let mut recording = Recording::open(path.as_ref())?;
    let topics = Frames::of(&mut recording, &FrameOptions::default())?
        .topics()
        .clone();

    let clock = Arc::new(SystemClock::default());
    let mut bus = MemoryTransport::default();
    let config = NodeConfig {
        standard_deviation: true,
        outliers: true,
        ..NodeConfig::new(topics.clone())
    };
    let completer = Completer::new(&Weights::builtin())?;
    let server =
        port.map(|port: u16| Foxglove::listen(([127, 0, 0, 1], port).into(), clock.clone()));
    let server = server.transpose()?;
    let node = match &server {
        Some(server) => {
            println!("ws://{}", server.address());
            let mut shown = server.beside(&mut bus);
            Node::new(config, completer, None, clock.clone(), &mut shown)?
        }
        None => Node::new(config, completer, None, clock.clone(), &mut bus)?,
    };
    let handle = node.handle();
    let running = std::thread::spawn(move || node.run());

    for _ in 0..times {
        let started = clock.elapsed();
        let mut first = None;
        recording.visit(&|_| true, &mut |topic, message| {
            let first = *first.get_or_insert(message.times.log);
            let due = started + Duration::from_nanos(message.times.log - first);
            std::thread::sleep(due.saturating_sub(clock.elapsed()));
            bus.send(&topic.name, message.data);
            Ok(())
        })?;
        // Wait until the last images are completed or dropped.
        std::thread::sleep(Duration::from_secs(1));
    }
    handle.stop();
    running.join().unwrap()?;
    let status = handle.status();
    println!(
        "{} images, {} completed, left out: {:?}; the last took {:?}, {:?} after its receipt",
        status.images, status.completed, status.left_out, status.latency, status.age
    );
    Ok(())
}
