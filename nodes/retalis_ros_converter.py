#!/usr/bin/env python3
from retalis.ros.converter import main

raise SystemExit(main())
