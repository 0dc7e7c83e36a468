# The commands for people and for CI. `make check` runs anywhere, `make test` is the gate; .ci/run says what CI runs.

CARGO ?= cargo
RECORDING ?= recordings/cup.mcap

# All that an installed system is made of: the tests are built with it, once.
FEATURES = rig,page,fleet

.PHONY: help demo rig-demo ui page-demo page-test page-bench page-load fleet-test fleet-bench fleet-presses fuse-times fleet-simulation fleet-demo deps lint check test calibration-trial calibration-against-opencv error-trial surface-trial verdict-trial fusion-trial bench deb deb-test rig-vm torture interop kinect-driver

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 16

demo: ## reconstruct a recording and print where the model is
	$(CARGO) run --release -- --replay $(RECORDING)

rig-demo: deps ## run the daemon with a simulated rig on this machine, and make a model of a capture
	$(CARGO) build --release --locked --features rig
	scripts/rig-demo.sh $(RECORDING)

ui: ## build the operator's page into ui/dist, from where the feature `page` takes it (npm; Node 18 or later)
	scripts/ui.sh

page-demo: ui ## a simulated rig, the daemon and the operator's page on this machine; prints a link for a browser (PICTURES=docs takes the pictures of docs/operating.md)
	$(CARGO) build --release --locked --features aravis,page
	SCAND=target/release/scand node ui/demo.mjs

page-test: ui ## try the page with Debian's Chromium, the daemon and a simulated rig (N=3 repeats; SCAND=PROGRAM needs no build)
	$(if $(SCAND),,$(CARGO) build --locked --package scand --features rig,page)
	cd ui && CARGO="$(CARGO)" SCAND=$(or $(SCAND),target/debug/scand) N=$(or $(N),1) npx playwright test

page-bench: ui ## how much later captures are taken because of the page, and what it needs (PRESSES=200, MINUTES=10; SCAND=PROGRAM)
	$(if $(SCAND),,$(CARGO) build --release --locked --package scand --features aravis,page)
	SCAND=$(or $(SCAND),target/release/scand) node ui/bench.mjs

page-load: ui ## how long Chromium held to 20 Mbit/s takes until it shows a model, and how smoothly that turns (LOADS=4, RESOLUTION=240; SCAND=PROGRAM)
	$(if $(SCAND),,$(CARGO) build --release --locked --package scand --features aravis,page)
	SCAND=$(or $(SCAND),target/release/scand) node ui/load.mjs

fleet-test: ## make models by workers while workers and servers are killed (N=20 repeats it with other seeds; Debian's nats-server)
	SCAND_TORTURE=$(or $(N),1) $(CARGO) test --locked --package scand --features fleet --test fleet -- --nocapture --test-threads 2

fleet-bench: ## processor time, bytes and wall time of 100 captures made here and by one and two workers (SCAND=PROGRAM needs no build)
	$(if $(SCAND),,$(CARGO) build --release --config profile.release.package.zstd-sys.opt-level=3 --locked --features fleet)
	scripts/fleet-bench.py --scand $(or $(SCAND),target/release/scand)

fleet-presses: ## time from a press to the disk with the server there, away and slow (PRESSES=200; SCAND=PROGRAM needs no build)
	$(if $(SCAND),,$(CARGO) build --release --locked --features aravis,fleet)
	scripts/fleet-presses.py --presses $(or $(PRESSES),200) --scand $(or $(SCAND),target/release/scand)

fuse-times: ## time until the daemon has registered and fused two and four captures of an object, how much later models are, and the memory of four at 5 megapixels (ROUNDS=5; ONLY=rounds or large; SCAND=PROGRAM needs no build)
	$(if $(SCAND),,$(CARGO) build --release --locked --features rig)
	scripts/fuse-times.py --rounds $(or $(ROUNDS),5) $(if $(ONLY),--only $(ONLY)) --scand $(or $(SCAND),target/release/scand)

fleet-simulation: ## how many jobs a second one server passes on, without making models
	$(CARGO) test --locked --package scand --features fleet --test fleet -- simulation:: --ignored --nocapture

fleet-demo: ## a server, a simulated rig and two workers on this machine, then an archive (SCAND=PROGRAM needs no build)
	$(if $(SCAND),,$(CARGO) build --release --locked --features aravis,fleet)
	SCAND=$(or $(SCAND),target/release/scand) scripts/fleet-demo.sh

deps: ## install what the tests need beyond Rust and a C compiler (as root on Debian)
	tests/deps.sh

lint: ## format, spelling, licences, clippy over each combination of features, and documentation, without root
	@CARGO=$(CARGO) scripts/lint.sh

check: lint ## what needs neither root nor a camera library: `lint`, then the short tests with the default features
	scripts/part.sh "tests, default features" $(CARGO) test --locked --workspace --quiet -- --skip long::

test: deps lint ## the gate: install what the tests need, then `lint`, then all tests, the rig's and the page's among them
	if command -v npm >/dev/null; then scripts/part.sh "the page's files" $(MAKE) ui; fi
	scripts/part.sh "tests, built" $(CARGO) test --locked --workspace --features $(FEATURES) --no-run
	scripts/part.sh "tests of the fleet, built" $(CARGO) test --locked --workspace --features $(FEATURES) --test fleet --no-run
	scripts/part.sh "tests" $(CARGO) test --locked --workspace --features $(FEATURES)
	scripts/part.sh "tests, fleet" $(CARGO) test --locked --workspace --features $(FEATURES) --test fleet -- --test-threads 4
	scripts/part.sh "tests, without the laboratory" $(CARGO) test --locked --package scand --no-default-features --features $(FEATURES) --lib --quiet absent::
	scripts/part.sh "tests, page" scripts/page-test.sh

calibration-trial: ## calibrate rendered sessions with and without faults, print the messages, and hold stated errors against true ones (SCAND_TRIAL=full for 5 megapixels)
	$(CARGO) test --release --locked --test offline -- calibration_trial:: stated_uncertainties_hold_over_many_sessions --ignored --nocapture --test-threads 1
	$(CARGO) test --release --locked --package scand-core --lib -- calibration::fit:: --ignored --nocapture --test-threads 1

calibration-against-opencv: ## calibrate the same pictures with scand and OpenCV: residuals, focal lengths, times (PICTURES=FOLDER or a recording, else simulated; RUNS=3; SCAND=PROGRAM needs no build)
	$(if $(SCAND),,$(CARGO) build --release --locked)
	scripts/calibration-against-opencv.py $(PICTURES) $(if $(BOARD),--board $(BOARD)) --runs $(or $(RUNS),3) --scand $(or $(SCAND),target/release/scand)

error-trial: ## compare the errors that models state with the truth, over shapes, rigs and N seeds (3)
	$(CARGO) test --release --locked --package scand-lab --test rendered error_trial -- --include-ignored --nocapture --test-threads 1

surface-trial: ## hold an egg, a ball and a prism to what is promised of them, and every shape and method to itself without fairing, over N seeds (3)
	$(CARGO) test --release --locked --package scand-lab --test rendered surface_trial -- --include-ignored --nocapture --test-threads 1

verdict-trial: ## compare the verdicts on N simulated captures (255), with faults and without, with the truth, and print a table
	N=$(or $(N),255) $(CARGO) test --release --locked --package scand-lab --test rendered verdict_trial::verdict_trial -- --ignored --nocapture

fusion-trial: ## fuse rendered sessions of ten shapes in N random poses each (10), bowls with fruit, pots with rings, other calibrations and what must not be fused, and show what each capture adds; print a table, or the rows with the word ONLY in their name
	N=$(or $(N),10) $(CARGO) test --release --locked --test offline fusion_trial::ten_shapes -- --ignored --nocapture --test-threads 1

bench: ## time each stage and a whole replay (SCAND_BENCH_RECORDING names another recording)
	$(CARGO) bench --locked

deb: deps ## build the Debian package into target/debian
	CARGO=$(CARGO) scripts/deb.sh

deb-test: deb ## install the package on a clean Debian 12 in a folder, run it, purge it (as root)
	scripts/deb-test.sh

rig-vm: deps ## check the package in a guest whose kernel plays cameras and foot switches (as root on Debian; CHAPTERS="video pedal")
	CARGO=$(CARGO) tests/rig-vm/run.sh $(CHAPTERS)

torture: deps ## test the promises of docs/promises.md that are about faults (as root on Debian; N=60 for hours; CHAPTERS="power disk")
	N=$(or $(N),1) CARGO=$(CARGO) tests/torture/run.sh $(CHAPTERS)

# With cameras, where their libraries are installed.
interop: CAMERAS = $(shell pkg-config --exists 'aravis-0.8 >= 0.8.25' libopenni2 2>/dev/null && echo --features rig)
interop: ## check what scand writes with other people's readers (500 MB of readers into target/interop; SCAND=PROGRAM needs no build)
	$(if $(SCAND),,$(CARGO) build --release --locked $(CAMERAS))
	SCAND=$(or $(SCAND),target/release/scand) tests/interop/run.sh

kinect-driver: ## build OpenNI2's driver for the Kinect v1 from Debian's source and install it (as root on Debian)
	scripts/kinect-driver.sh
