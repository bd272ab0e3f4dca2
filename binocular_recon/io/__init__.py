# SPDX-License-Identifier: Apache-2.0
"""Files, bags and messages to arrays and back."""
