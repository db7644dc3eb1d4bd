"""What `--help` of each command teaches: what happens, examples, where results land."""

NEW = """\
what happens: writes fmus/<name>/case.toml with the FMU's own names, units, start values and bounds, every
line that needs you marked EDIT; copies the FMU beside it; writes README and example CSV files with the
right columns into data/<name>/. Nothing is overwritten. Save two CSV files there (measured.csv, and
inputs.csv where the FMU has inputs), go through the lines marked EDIT, then check, then run.

examples:
  studies new Room.fmu
  studies new Room.fmu --list              its variables; nothing is written
  studies new Room.fmu --output TAir --parameter UWin 'wall.*'
  studies new Room.fmu --to ~/office/room  a folder of its own, CSV files beside the case file
"""
CHECK = """\
what happens: reads the case, checks names, units, bounds and data against the FMU, simulates the
estimates and the corners of the box, moves every parameter and every input, asks again in another process
and at half the communication step, watches the memory, and says what the profile will cost. The FMU runs in
processes of its own: a crash or a hang is a line in the table. It simulates for two minutes at most and says
what a slow model had to go without; --thorough leaves nothing out. What it simulates is kept for the study.
Exit code 1 if anything fails; each finding says what to do.

examples:
  studies check                            the office
  studies check fmus/office/case.toml      a case file of your own
  studies check office --window 8-16 --profile paper --json
  studies check slow-model --thorough      however long it takes
"""
SIMULATE = """\
what happens: one training design (its first n rows are the training set of size n), a validation and a
test set that every study shares. Every simulated row is stored in data/<case>/generated/simulations/, a
folder of Parquet files whose _README.txt says how to read them, and is never simulated again, whatever asks
for it: sampling, Sobol indices, screening checks or polishing. Failed simulations are kept as such, counted,
and left out of training; --retry-failed asks them again. When too many fail, the campaign stops with exit
code 1 (simulation.max_failed_share in the case file).

examples:
  studies simulate --profile paper
  studies simulate my-case/ --jobs 8
  studies simulate my-case/ --dask tcp://scheduler:8786
  studies simulate --retry-failed          after the licence server is back
"""
SENSITIVITY = """\
what happens: Saltelli's sample on the FMU itself, indices with bootstrapped confidence intervals at
every output step. Lands in mlruns/results/<label>/sensitivity.npz; the table shows averages over time.

examples:
  studies sensitivity
  studies sensitivity office --window 8-16 --json
"""
TUNE = """\
what happens: one Optuna study per size in mlruns/optuna.journal; each trial trains a PELS-VAE and
becomes an MLflow run with its learning curves and errors in kelvin. The best of each size lands in
mlruns/champions/<label>/ and in the MLflow registry. A resumed study equals an uninterrupted one; more
--trials extend it.

examples:
  studies tune                             all sizes of the profile
  studies tune --n-train 32 128 --trials 20
"""
CALIBRATE = """\
what happens: differential evolution searches the whole box on the stored surrogate; the FMU is asked at
the found point (the screening gap) and polished from there by LS-TRF. Every FMU call is counted. Needs
the champion folder alone. Lands in mlruns/results/<label>/calibration-n<size>.json and .npz, and in
MLflow.

--method adaptive needs the case alone: no training set, nothing to train. A small design fills the box; then
every simulation goes where a Gaussian process of all residuals so far expects the lowest error. It stops
when little gain is expected, at the latest after --max-calls; with --target only at that error or then.
Every simulation is stored at once: interrupted, even killed, the same command reads them and goes on.
--parallel Q asks Q rows per round (fewer rounds, more calls), spread over --jobs. Lands in
mlruns/results/<label>/calibration-adaptive.json and .npz, in MLflow and, with studies report, on a page.

examples:
  studies calibrate --method adaptive      the office, 100 FMU calls at most
  studies calibrate my-case --method adaptive --max-calls 60 --parallel 4 --jobs 4
  studies calibrate --n-train 64           prints the stored result if nothing changed
  studies calibrate --n-train 64 --again   calibrates once more: the same numbers
  studies calibrate --max-calls 100 --target 0.0121 --json
"""
REPORT = """\
what happens: gathers all stored results of the label into mlruns/reports/<label>/index.html with its
figures.

examples:
  studies report
  studies report office-recorded --profile paper
"""
UI = """\
what happens: starts `mlflow ui` on 127.0.0.1 with this project's store (mlruns/mlflow.db) and prints
the address. Ctrl-C stops it.

examples:
  studies ui
  studies ui --port 8080
  studies ui --dry-run --json              what would be started
"""
IMPORT = """\
what happens: reads a recording as published (variables TRoom, TEnv, TSupply, FlowSupply, TRLTSupply,
RLTFlow, IrrGH every 1800 s and Occupancy every 600 s, first column time in s), checks it, and writes
data/office-recorded/recording_1800s.csv and occupancy_600s.csv for the case office-recorded.

examples:
  studies import-recording identification_data.mat
  studies import-recording ThermalNetwork.fmu
  studies import-recording recording_1800s.csv occupancy_600s.csv
"""
RUN = """\
what happens: check, simulate, sensitivity, tune, calibrate (every size), report. A finished stage is
skipped, an interrupted one goes on where it stopped. The report lands in
mlruns/reports/<label>/index.html.

examples:
  studies run                              the office, quick profile
  studies run office-recorded --seed 3
  studies run office --n-train 32 64 --trials 4
"""
