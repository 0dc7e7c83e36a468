//! How many jobs one server passes on: rigs and workers that send and fetch everything that a job needs and make no
//! models. It measures and judges nothing, so it runs only when it is asked for (`make fleet-simulation`).

use crate::test_bench::{TestBench, runtime, simulated};
use async_nats::jetstream::consumer::{AckPolicy, PullConsumer, pull};
use async_nats::jetstream::{self, Context};
use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt, stream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Bytes of a piece of a file, as in the product.
const PIECE: usize = 512 << 10;
/// Pieces of one file that are under way at the same time.
const PIECES_IN_FLIGHT: usize = 4;
/// Jobs that are offered at the same time, and workers.
const JOBS_IN_FLIGHT: usize = 32;
const WORKERS: usize = 16;

/// One size of job.
#[derive(Clone, Copy)]
struct Load {
    jobs: usize,
    capture_bytes: usize,
    result_bytes: usize,
}

#[test]
#[ignore = "measures; make fleet-simulation runs it"]
fn jobs_a_second_through_one_server() {
    let megabyte = 1_000_000;
    let loads = [
        Load {
            jobs: 2000,
            capture_bytes: 10_000,
            result_bytes: 10_000,
        },
        Load {
            jobs: 200,
            capture_bytes: 5 * megabyte,
            result_bytes: 2 * megabyte,
        },
        Load {
            jobs: 80,
            capture_bytes: 25 * megabyte,
            result_bytes: 10 * megabyte,
        },
    ];
    for load in loads {
        let Some(bench) = TestBench::start("") else {
            return;
        };
        make_streams(&bench);
        let seconds = runtime().block_on(pass_on(&bench.address(), load));
        let rate = load.jobs as f64 / seconds;
        let bytes = (load.capture_bytes + load.result_bytes) as f64 / 1e6;
        println!(
            "shown: {} jobs of {bytes:.2} MB in {seconds:.1} s: {rate:.1} jobs/s, {:.0} MB/s stored",
            load.jobs,
            rate * bytes
        );
    }
}

/// Lets the program itself make the streams, with the limits that it gives them.
fn make_streams(bench: &TestBench) {
    let mut worker = bench.worker("w", &[]);
    let one = ["--capture", "ball-000", "--quiet"];
    let output = bench.by_fleet(&simulated(6), "out", &one).output().unwrap();
    assert!(output.status.success());
    worker.kill();
}

/// Passes all jobs on, from the offer to the result that the rig has fetched and erased; in how many seconds.
async fn pass_on(address: &str, load: Load) -> f64 {
    let client = async_nats::connect(address).await.unwrap();
    let context = jetstream::new(client);
    let consumer: PullConsumer = context
        .create_consumer_on_stream(
            pull::Config {
                durable_name: Some("simulation".into()),
                filter_subject: "scand.job.simulation.m4.>".into(),
                ack_policy: AckPolicy::Explicit,
                ..Default::default()
            },
            "SCAND_JOBS",
        )
        .await
        .unwrap();
    let began = Instant::now();
    let taken = AtomicUsize::new(0);
    let address = address.to_owned();
    let workers = std::thread::spawn(move || {
        let works = (0..WORKERS).map(|_| work(&address, &consumer, &taken, load));
        runtime().block_on(futures_util::future::join_all(works));
    });
    stream::iter(0..load.jobs)
        .for_each_concurrent(JOBS_IN_FLIGHT, |number| offer(&context, number, load))
        .await;
    let seconds = began.elapsed().as_secs_f64();
    workers.join().unwrap();
    seconds
}

/// What a rig does for one job.
async fn offer(context: &Context, number: usize, load: Load) {
    let digest = format!("{number:064x}");
    let capture = |piece| format!("scand.capture.hall.{digest}.{piece}");
    send(context, load.capture_bytes, capture).await;
    let job = format!("scand.job.simulation.m4.hall.{digest}");
    store(context, job, Bytes::from(vec![b'x'; 2000])).await;
    let result = format!("scand.result.hall.{digest}");
    while fetch(context, "SCAND_RESULTS", &result).await.is_none() {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let part = |piece| format!("scand.part.hall.{digest}.w.i.{piece}");
    fetch_all(context, "SCAND_RESULTS", load.result_bytes, part).await;
    let erased = (0..pieces(load.result_bytes)).map(part);
    for subject in erased
        .chain((0..pieces(load.capture_bytes)).map(capture))
        .chain([result.clone()])
    {
        let client = context.client();
        client.publish(subject, Bytes::new()).await.unwrap();
    }
}

/// What a worker does.
async fn work(address: &str, consumer: &PullConsumer, taken: &AtomicUsize, load: Load) {
    let context = jetstream::new(async_nats::connect(address).await.unwrap());
    while taken.load(Ordering::Relaxed) < load.jobs {
        let batch = consumer.batch().max_messages(1);
        let batch = batch.expires(Duration::from_secs(2));
        let Some(message) = batch.messages().await.unwrap().try_next().await.unwrap() else {
            continue;
        };
        let digest = message.subject.rsplit('.').next().unwrap();
        let capture = |piece| format!("scand.capture.hall.{digest}.{piece}");
        fetch_all(&context, "SCAND_CAPTURES", load.capture_bytes, capture).await;
        let part = |piece| format!("scand.part.hall.{digest}.w.i.{piece}");
        send(&context, load.result_bytes, part).await;
        let result = format!("scand.result.hall.{digest}");
        store(&context, result, Bytes::from(vec![b'x'; 500])).await;
        message.ack().await.unwrap();
        taken.fetch_add(1, Ordering::Relaxed);
    }
}

fn pieces(bytes: usize) -> usize {
    bytes.div_ceil(PIECE)
}

async fn store(context: &Context, subject: String, bytes: Bytes) {
    let stored = context.publish(subject, bytes).await.unwrap();
    stored.await.unwrap();
}

async fn send(context: &Context, bytes: usize, subject: impl Fn(usize) -> String) {
    let piece = Bytes::from(vec![b'x'; PIECE.min(bytes)]);
    stream::iter(0..pieces(bytes))
        .for_each_concurrent(PIECES_IN_FLIGHT, |number| {
            store(context, subject(number), piece.clone())
        })
        .await;
}

async fn fetch(context: &Context, stream: &str, subject: &str) -> Option<Bytes> {
    let asked = format!("$JS.API.DIRECT.GET.{stream}.{subject}");
    let client = context.client();
    let answer = client.request(asked, Bytes::new()).await.unwrap();
    let found = answer.status.is_none() || answer.status == Some(async_nats::StatusCode::OK);
    Some(answer.payload).filter(|payload| found && !payload.is_empty())
}

async fn fetch_all(
    context: &Context,
    stream_name: &str,
    bytes: usize,
    subject: impl Fn(usize) -> String,
) {
    stream::iter(0..pieces(bytes))
        .for_each_concurrent(PIECES_IN_FLIGHT, |number| {
            let subject = subject(number);
            async move {
                assert!(
                    fetch(context, stream_name, &subject).await.is_some(),
                    "{subject}"
                );
            }
        })
        .await;
}
