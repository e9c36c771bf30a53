//! Two participants with their sockets, on the loopback interface.

use std::{sync::mpsc, time::Duration};

use lsdc_dds::{Error, Participant, Qos, Settings};

const IMAGE: &str = "sensor_msgs/msg/Image";
const PATIENCE: Duration = Duration::from_mins(1);
/// A domain that no other program on the machine should use.
const DOMAIN: u32 = 213;

fn participant(node: &str) -> Participant {
    let settings = Settings {
        node: node.into(),
        localhost_only: true,
        ..Settings::default()
    };
    Participant::new(DOMAIN, settings).expect("a participant")
}

/// Sends depth images of 1.2 MB there and back.
#[test]
fn messages_arrive_unchanged_and_come_back() {
    let (here, there) = (participant("here"), participant("there"));
    let (sender, received) = mpsc::channel();
    let echo = there
        .advertise("/back", IMAGE, Qos::LATCHED)
        .expect("a publisher");
    let back = here
        .subscribe(
            "/back",
            IMAGE,
            Qos::LATCHED,
            Box::new(move |message| sender.send(message).expect("a receiver")),
        )
        .expect("a subscription");
    let forth = there
        .subscribe(
            "/forth",
            IMAGE,
            Qos::LATCHED,
            Box::new(move |message| echo.publish(&message).expect("published")),
        )
        .expect("a subscription");
    let publisher = here
        .advertise("/forth", IMAGE, Qos::LATCHED)
        .expect("a publisher");
    for seed in 0..3u8 {
        let message: Vec<u8> = [0, 1, 0, 0]
            .into_iter()
            .chain((0..1_228_852u32).map(|at| (at >> 2) as u8 ^ seed))
            .collect();
        publisher.publish(&message).expect("published");
        assert!(received.recv_timeout(PATIENCE).expect("a message") == message);
    }
    let (back, forth) = (back.status(), forth.status());
    assert_eq!((back.reception.received, back.dropped), (3, 0));
    assert_eq!((forth.reception.received, forth.reception.lost), (3, 0));
    assert_eq!(publisher.status().subscribers.matched, 1);
    assert!(here.participants().contains(&"/there".into()));
    let topics = here.topics();
    assert!(topics.iter().any(|topic| topic.name == "/forth"
        && topic.message_type == IMAGE
        && topic.subscribers == 1));
}

#[test]
fn names_and_sizes_that_cannot_be_are_refused() {
    let participant = participant("names");
    for (topic, message_type) in [("camera", IMAGE), ("/camera", "sensor_msgs/Image")] {
        assert!(matches!(
            participant.advertise(topic, message_type, Qos::DEFAULT),
            Err(Error::Name { .. })
        ));
    }
    let publisher = participant
        .advertise("/camera", IMAGE, Qos::DEFAULT)
        .expect("a publisher");
    assert!(matches!(
        publisher.publish(&[0, 1]),
        Err(Error::MessageSize { bytes: 2, .. })
    ));
    assert!(matches!(
        Participant::new(233, Settings::default()),
        Err(Error::Domain(233))
    ));
}
