# SPDX-License-Identifier: Apache-2.0
"""The workflow runs what ``make test`` runs, and the forms ask for what a report needs."""

from __future__ import annotations

import re
from typing import Any

import pytest
import yaml

from test.conftest import REPOSITORY
from test.project_files import PYTHONS

FOLDER = REPOSITORY / '.github'
WORKFLOW: dict[Any, Any] = yaml.safe_load((FOLDER / 'workflows' / 'ci.yml').read_text())
FORMS = ['bug_report.yml', 'feature_request.yml']


def form(name: str) -> dict[str, Any]:
    content: dict[str, Any] = yaml.safe_load((FOLDER / 'ISSUE_TEMPLATE' / name).read_text())
    return content


def test_workflow_runs_on_each_python() -> None:
    matrix = WORKFLOW['jobs']['test']['strategy']['matrix']
    assert matrix['python'] == PYTHONS
    assert all(more['python'] in PYTHONS for more in matrix['include'])
    systems = {*matrix['os'], *(more['os'] for more in matrix['include'])}
    assert systems == {'ubuntu-22.04', 'ubuntu-24.04'}


def test_workflow_runs_the_whole_suite() -> None:
    (job,) = WORKFLOW['jobs'].values()
    assert [step['run'] for step in job['steps'] if 'run' in step] == ['.ci/run']
    assert (REPOSITORY / '.ci' / 'run').stat().st_mode & 0o100
    (limit,) = re.findall(r'timeout .* (\d+)m make', (REPOSITORY / '.ci' / 'run').read_text())
    assert job['timeout-minutes'] > int(limit)
    # `on`, which YAML 1.1 reads as true
    assert {'push', 'pull_request'} <= set(WORKFLOW[True])


def test_workflow_can_change_nothing_and_uses_actions_by_commit() -> None:
    assert WORKFLOW['permissions'] == {'contents': 'read'}
    used = re.findall(r'uses: (.*)', (FOLDER / 'workflows' / 'ci.yml').read_text())
    assert len(used) == 2
    for action in used:
        assert re.fullmatch(r'actions/(checkout|setup-python)@[0-9a-f]{40} # v[\d.]+', action)


@pytest.mark.parametrize('name', FORMS)
def test_forms_are_such_as_github_reads(name: str) -> None:
    content = form(name)
    assert content['name'] and content['description']
    ids = [field['id'] for field in content['body']]
    assert len(ids) == len(set(ids))
    for field in content['body']:
        assert field['type'] in {'input', 'textarea'}
        assert field['attributes']['label']
    assert any(
        field['validations']['required'] for field in content['body'] if 'validations' in field
    )


def test_a_bug_report_comes_with_data_and_versions() -> None:
    fields = {field['id']: field for field in form('bug_report.yml')['body']}
    for required in ('what', 'data', 'versions', 'system'):
        assert fields[required]['validations'] == {'required': True}
    data = fields['data']['attributes']['description']
    assert all(word in data for word in ('bag of a few frames', 'image pair', 'calibration'))
    assert '`binocular-recon --version`' in fields['versions']['attributes']['description']


def test_all_templates_are_tested() -> None:
    names = {path.name for path in (FOLDER / 'ISSUE_TEMPLATE').iterdir()}
    assert names == {*FORMS, 'config.yml'}
    assert isinstance(form('config.yml')['blank_issues_enabled'], bool)


def test_pull_request_template_names_targets_that_exist() -> None:
    template = (FOLDER / 'PULL_REQUEST_TEMPLATE.md').read_text()
    targets = re.findall(r'`make ([\w-]+)`', template)
    assert {'test', 'lint'} <= set(targets)
    makefile = (REPOSITORY / 'Makefile').read_text()
    assert all(re.search(rf'^{target}:', makefile, re.MULTILINE) for target in targets)
