"""Jobs are carried out and reported: a progress bar, then lines or JSON on jobs and the batch."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from defocus_cli.words import console
from defocus_core.batch.journal.record import Failed, Record, error_line
from defocus_core.batch.workers import pipeline, run
from defocus_core.batch.workers.run import Execution, Plan, Summary
from defocus_core.errors import note_kind, with_dashes
from defocus_core.io.read_files import spoken
from defocus_core.request.job import FRAME_ROLE, Job
from defocus_core.request.lens import lens_record, lens_record_words, lens_words
from defocus_core.system.text import counted

if TYPE_CHECKING:
    from defocus_core.batch.journal.progress import Progress


def job_record(job: Job) -> dict[str, Any]:
    """The record of a job for JSON: inputs, lens and outputs."""
    return {
        "stem": job.sample_id,
        **{role: str(path) for role, path in _own_files(job).items()},
        "lens": lens_record(job.lens),
        "outputs": {kind: str(path) for kind, path in job.paths.items()},
        "previews": {kind: str(path) for kind, path in job.previews.items()},
    }


def _own_files(job: Job) -> dict[str, Path]:
    """The inputs of a job by role, without those of other frames of its shot."""
    return {role: path for role, path in job.files.items() if not role.startswith(FRAME_ROLE)}


def job_line(job: Job) -> str:
    """The line of a job: inputs, lens and outputs, in words."""
    inputs = ", ".join(dict.fromkeys(map(str, _own_files(job).values())))
    others = 0 if job.shot is None else len(job.shot.pictures.keys() - {job.picture.frame})
    inputs += f" and {counted(others, 'other frame')} of the shot" if others else ""
    outputs = f"would write {_written_words(job)}"
    return f"{job.sample_id}: {lens_words(job.lens)}; would read {inputs}; {outputs}"


def outcome_record(job: Job, record: Record, *, done_before: bool = False) -> dict[str, Any]:
    """The outcome of a job, for JSON: the fields of `job_record`, and those of its record."""
    end, completed = record.end, record.completed
    told = {name: getattr(completed, name, None) for name in _OF_PICTURES}
    return {
        **job_record(job),
        **{"status": end.status, "reason": end.reason, "message": end.message},
        **{"warnings": list(end.warnings), "quality": record.quality},
        **told,
        "lens": lens_record(job.lens) if completed is None else completed.lens,
        "done_before": done_before,
        "render_seconds": end.seconds.get("render"),
        "render_cpu_seconds": end.seconds.get("cpu"),
        "stats": {} if completed is None else dict(completed.stats),
    }


_OF_PICTURES = ("size", "color_note", "depth_note", "depth_repair", "coc_px", "device", "back")


def outcome_lines(job: Job, record: Record, *, verbose: bool) -> Iterator[str]:
    """The outcome of a job, in words: a line, a line for each warning, and more if ``verbose``."""
    end = record.end
    if isinstance(end, Failed):
        yield f"defocus: {end.message}"
        if verbose:
            yield from end.trace.splitlines()
        return
    (width, height), (near, far) = end.size, end.coc_px
    yield (
        f"{job.sample_id}: {width}x{height}, {lens_record_words(end.lens)}, "
        f"CoC {near:.2f} to {far:.2f} px, {end.seconds['render']:.2f} s -> {_written_words(job)}"
    )
    for warning in end.warnings:
        yield f"{job.sample_id}: warning: {warning}"
    if not verbose:
        return
    yield f"  colour: {end.color_note}"
    yield f"  depth: {end.depth_note}"
    machine = f"{end.device} ({end.back}), {counted(job.machine.threads, 'thread')}"
    yield f"  {machine}, {record.quality}, {end.seconds['cpu']:.2f} CPU s"
    if end.stats:
        yield "  " + ", ".join(f"{name} {count:.6g}" for name, count in end.stats.items())


def _written_words(job: Job) -> str:
    """The files of a job, grouped by name, like ``out/{left,right}/a.exr``."""
    if job.outputs.file:
        return str(job.written[0])
    folders: dict[str, list[str]] = {}
    for path in job.written:
        folders.setdefault(path.name, []).append(path.parent.name)
    return ", ".join(
        str(job.outputs.root / (f"{{{','.join(kinds)}}}" if len(kinds) > 1 else kinds[0]) / name)
        for name, kinds in folders.items()
    )


def carry_out(
    jobs: Sequence[Job],
    out: Path,
    execution: Execution,
    *,
    dry_run: bool,
    contact: int | None,
    as_json: bool,
    verbose: bool,
    processes: int = 1,
) -> None:
    """Do jobs, or show what is to be done; report, write the contact sheet, and end the command."""
    is_batch = execution.has_index
    if contact is not None:
        from defocus_core.reports.sheets import require_room, write_contact_sheet

        require_room(jobs)
    if dry_run:
        plan = run.make_plan(jobs, out, execution)
        report_plan(plan, processes, each=verbose or not is_batch, as_json=as_json)
        return
    report = BatchReport(
        each=verbose or not is_batch, keep=as_json, verbose=verbose, raises=execution.raises
    )
    unit = "job" if is_batch else "picture"
    with tile_bar() if execution.raises else report.bar(unit) as count:
        if count is not None:
            execution = replace(execution, execute=partial(pipeline.execute, progress=count))
        summary = run.run(jobs, out, execution, report.ended, report.planned)
    for line in summary_lines(summary) if is_batch else ():
        console.stderr(line)
    if contact is not None and (sheet := write_contact_sheet(jobs, contact)):
        console.stderr(f"contact sheet -> {sheet}")
        summary.written.append(sheet)
    if as_json:
        written = {"written": [str(path) for path in summary.written]} if is_batch else {}
        console.print_json(**run_record(summary, report, jobs), **written)
    end(summary)


def report_plan(plan: Plan, processes: int, *, each: bool, as_json: bool) -> None:
    """Report the jobs to do, and on stderr those that would fail.

    `each`: whether to print a line for each job.
    """
    from defocus_core.picture.forecast import forecasts

    todo = [*plan.jobs_of(plan.due)]
    found, unusable = forecasts(todo) if todo else ({}, [])
    if each and len(plan.jobs) == len(unusable) == 1:
        raise unusable[0]  # as the command would
    for error in unusable:
        console.stderr(f"defocus: {error!s}")
    looked_at, files = len(found) + len(unusable), sum(len(job.names) for job in todo)
    done_before, later = len(plan.settled), len(plan.later)
    peak_mb = max((forecast.peak_mb for forecast in found.values()), default=None)
    if as_json:
        told = ({"forecast": found[k].record} if k in found else {} for k in range(len(todo)))
        pictures = [{**job_record(job), **more} for job, more in zip(todo, told, strict=True)]
        console.print_json(
            dry_run=True,
            jobs=len(plan.jobs),
            done_before=done_before,
            todo=len(todo),
            beyond_limit=later,
            files=files,
            looked_at=looked_at,
            unusable=len(unusable),
            processes=processes,
            peak_mb=peak_mb,
            again=dict(plan.again),
            kept=dict(plan.kept),
            pictures=pictures,
        )
    else:
        for number, job in enumerate(todo if each else ()):
            console.stdout(job_line(job), *(str(found[k]) for k in (number,) if k in found))
        beyond = f", {later} beyond the limit" if later else ""
        done = f"{counted(done_before, 'job')} done before"
        console.stdout(f"{done}, {len(todo)} to do{beyond}, {counted(files, 'file')} to write")
        if peak_mb is not None:
            of_each = f" in each of {processes} processes" if processes > 1 else ""
            few = f", going by {len(found)} of them" if len(found) < len(todo) else ""
            console.stdout(f"at most {peak_mb:.0f} MB of memory{of_each}{few}")
        console.stdout(*reasons_lines(plan))
    if unusable:
        problem = f"{len(unusable)} of {looked_at} whose inputs were opened would fail"
        raise click.ClickException(problem)


_WARNINGS = 3  # kinds with an example
_ALIKE = 5  # errors of one kind that are shown
_WORDS = {"ok": "done", "failed": "failed"}


class BatchReport:
    """Reports each job of a batch while it runs."""

    def __init__(
        self, *, each: bool, keep: bool = False, verbose: bool = False, raises: bool = False
    ) -> None:
        self.records: dict[str, dict[str, Any]] = {}
        self._raises = raises
        self._each, self._keep, self._verbose = each, keep, verbose
        self._bar: Any = None
        self._kinds: Counter[str] = Counter()  # jobs without outputs, by the kind of their message

    def planned(self, plan: Plan) -> None:
        """Report the jobs that were finished before."""
        for number in plan.settled if self._keep or self._each else ():
            job = plan.jobs[number]
            if self._keep:
                done = outcome_record(job, plan.recorded(number), done_before=True)
                self.records[job.sample_id] = done
            if self._each:
                console.stderr(f"{job.sample_id}: done before -> {_written_words(job)}")
        done_before, due = len(plan.settled), len(plan.due)
        if not self._each and done_before:
            console.stderr(f"{counted(done_before, 'job')} done before, {due} to do")
        for line in reasons_lines(plan):
            console.stderr(line)
        if self._bar is not None and due:
            with spoken():
                self._bar.reset(due)

    def ended(self, job: Job, record: Record) -> None:
        """Report the outcome of a job."""
        if self._keep:
            self.records[job.sample_id] = outcome_record(job, record)
        if self._raises and record.completed is None:
            return  # its error ends the command
        lines = list(outcome_lines(job, record, verbose=self._verbose))
        if record.completed is None and not self._verbose:
            kind = note_kind(record.end.message)
            self._kinds[kind] += 1
            if self._kinds[kind] > _ALIKE:
                more = "further ones are counted at the end, and listed by 'defocus status'"
                lines = [more] if self._kinds[kind] == _ALIKE + 1 else []
        for line in lines if self._each or record.completed is None else ():
            console.stderr(line)
        if self._bar is not None:
            with spoken():
                self._bar.update()

    @contextmanager
    def bar(self, unit: str) -> Iterator[None]:
        """Count jobs on a bar while the block runs, if stderr is a terminal."""
        with console.bar(unit) as self._bar:
            yield
        self._bar = None


@contextmanager
def tile_bar(unit: str = "tile") -> Iterator[Callable[[int, int], None]]:
    """Yield a function that shows (tiles done, tiles in all) of a lone picture on a bar."""
    with console.bar(unit) as tiles:

        def count(done: int, total: int) -> None:
            if tiles.total is None:
                tiles.set_description_str("", refresh=False)
                tiles.reset(total)
            tiles.update(done - tiles.n)

        if not tiles.disable:
            tiles.set_description_str("preparing")
        yield count


def summary_lines(summary: Summary) -> Iterator[str]:
    """The lines on an ended batch: counts, reasons, speed, then the commonest warnings."""
    ends = {word: summary.statuses[status] for status, word in _WORDS.items()}
    ends |= {"done before": summary.skipped, "left": summary.left}
    parts = ", ".join(f"{count} {word}" for word, count in ends.items() if count)
    line = f"{counted(summary.jobs, 'job')}: {parts or 'nothing to do'}"
    if summary.reasons:
        line += f" ({reasons_words(summary.reasons)})"
    if summary.warned:
        line += f", {summary.warned} with warnings in the journal"
    done, seconds = sum(summary.statuses.values()), summary.seconds
    if done and seconds:
        line += f"; {seconds:.1f} s"
    if done > 1 and seconds:
        pace, unit = (seconds / done, "s each") if done < seconds else (done / seconds, "a second")
        line += f", {pace:.3g} {unit}"
    yield line
    kinds = list(summary.warnings.counts.items())
    for example, count in kinds[:_WARNINGS]:
        yield f"  warning: {example}" + (f" (and {count - 1} more like it)" if count > 1 else "")
    if len(kinds) > _WARNINGS:
        yield f"  warning: {counted(len(kinds) - _WARNINGS, 'other kind')}"


def reasons_lines(plan: Plan) -> Iterator[str]:
    """The lines on the reasons why jobs are done again, and why changed jobs are kept."""
    for what, reasons in (("done again", plan.again), ("stay as they are", plan.kept)):
        if reasons:
            counts = ", ".join(f"{why} ({count})" for why, count in reasons.most_common())
            yield f"{what}: {counts}"


def reasons_words(reasons: Mapping[str, int]) -> str:
    """Reasons of failures with their counts, in words."""
    return ", ".join(f"{reason} {count}" for reason, count in sorted(reasons.items()))


def run_record(summary: Summary, report: BatchReport, jobs: Iterable[Job]) -> dict[str, Any]:
    """The JSON document of a run: counts, reasons, time, pictures, the error of a lone picture."""
    ended, error, told = (report.records.get(job.sample_id) for job in jobs), summary.error, {}
    if error is not None:  # as for a command without a result
        line, code = with_dashes(error_line(error), console.Due.keys), getattr(error, "code", None)
        exit_code = console.exit_code_of(error)
        told = {"error": {"message": line, "exit_code": exit_code, "code": code}}
    return {
        "dry_run": False,
        "jobs": summary.jobs,
        "done_before": summary.skipped,
        "left": summary.left,
        **{status: summary.statuses[status] for status in _WORDS},
        "reasons": dict(summary.reasons),
        "again": dict(summary.again),
        "kept": dict(summary.kept),
        "warned": summary.warned,
        "warnings": summary.warnings.counts,
        "seconds": summary.seconds,
        "interrupted": summary.interrupted,
        "pictures": [record for record in ended if record is not None],
        **told,
    }


def progress_lines(out: Path, state: Progress) -> Iterator[str]:
    """Progress of a batch, in words."""
    counts = [f"{n} {word}" for n, word in ((state.ok, "done"), (state.failed, "failed")) if n]
    left = f", {state.left} left" if state.left else ""
    again = f", {state.again} of them to be done again" if state.again else ""
    yield f"{out}: {', '.join(counts) or '0 done'}{left}{again}, {counted(state.jobs, 'job')}"
    if state.shards is not None:
        begun, division = state.shards["begun"], state.shards["of"]
        yield f"  {len(begun)} of {division} shards begun, not merged yet"
    for who in state.running:
        yield f"  running: {who}"
    if state.left and not state.running:
        yield "  not running; run the same command again to go on"
    if state.reasons:
        yield f"  {reasons_words(state.reasons)}"
    for failure in state.failures:
        yield "    {sample_id}: {reason}: {message}".format(**failure)


def end(summary: Summary) -> None:
    """End a command: raise an error if a job failed or the run was interrupted."""
    if summary.error is not None:
        raise summary.error
    if summary.interrupted and summary.left:
        problem = f"interrupted, {summary.left} of {summary.jobs} jobs left"
        raise console.Interrupted(f"{problem}; run the same command again to go on")
    failed = summary.statuses["failed"]
    if failed:
        problem = f"{failed} of {counted(summary.jobs, 'job')} failed"
        again = "it" if failed == 1 else "them"
        remedy = f"run the same command again to try {again} once more"
        raise click.ClickException(f"{problem} ({reasons_words(summary.reasons)}); {remedy}")
